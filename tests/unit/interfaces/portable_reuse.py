"""Messages that are written and read repeatedly: on a board without garbage.

tests/mpy/test_lean_codec.py builds a board's program of this file too: the tests compare octets,
since messages of a lean build have no equality.
"""

import sys

try:
    from uros.interfaces.geometry_msgs.msg import Twist
    from uros.interfaces.nav_msgs.msg import Odometry
    from uros.interfaces.sensor_msgs.msg import Imu
    from uros.interfaces.std_msgs.msg import Int32, String
except ImportError:  # MicroPython
    from geometry_msgs.msg import Twist
    from nav_msgs.msg import Odometry
    from sensor_msgs.msg import Imu
    from std_msgs.msg import Int32, String

BOARD = sys.implementation.name == "micropython"


def raises(errors, call, *args):
    try:
        call(*args)
    except errors:
        return
    raise AssertionError("nothing was raised")


def imu():
    message = Imu()
    message.header.stamp.sec = 1700000000
    message.header.stamp.nanosec = 999999999
    message.header.frame_id = "imu_link"
    message.orientation.z = 0.5
    message.linear_acceleration.y = -9.75
    message.orientation_covariance[0] = 0.25
    message.linear_acceleration_covariance[8] = 0.125
    return message


def odometry():
    message = Odometry()
    message.header.stamp.sec = 1700000000
    message.header.frame_id = "odom"
    message.child_frame_id = "base_link"
    message.pose.pose.orientation.w = 0.5
    message.pose.covariance[35] = 2.0
    message.twist.twist.angular.x = 3.0
    return message


def octets(message):
    buf = bytearray(b"\xaa" * message.cdr_size())
    assert message.pack_into(buf, 0, 0) == len(buf)
    return buf


def test_read_into_another():
    for source in (imu(), odometry(), Twist(), Int32(-5), String("äö")):
        buf = octets(source)
        reused = type(source)()
        for _ in range(2):
            assert reused.unpack_into(buf, 0, 0, len(buf)) == len(buf)
            assert octets(reused) == buf
        for end in range(len(buf)):
            raises(ValueError, reused.unpack_into, buf, 0, 0, end)
            raises(ValueError, reused.unpack_into, buf[:end], 0, 0, len(buf))
        assert octets(reused)


def test_big_endian():
    import struct

    # Big-endian octets: seconds, nanoseconds, length and doubles in reverse byte order.
    buf = bytes(octets(imu()))
    big = struct.pack(">iII", *struct.unpack("<iII", buf[:12])) + buf[12:24]
    big += struct.pack(">37d", *struct.unpack("<37d", buf[24:]))
    reused = Imu()
    assert reused.unpack_into(big, 0, 0, len(big), False) == len(big)
    assert octets(reused) == buf
    assert reused.header.stamp.sec == 1700000000


def test_halves():
    stamp = imu().header.stamp
    assert (stamp.high, stamp.low) == (1700000000 >> 16, 1700000000 & 65535)
    for sec in (-1, 0, -2147483648, 2147483647, 65536):
        stamp.sec = sec
        assert (stamp.sec, stamp.high, stamp.low) == (sec, sec >> 16, sec & 65535)
        stamp.high = 5
        stamp.low = 7
        assert stamp.sec == 5 * 65536 + 7


def test_values_that_do_not_fit():
    message = imu()
    message.orientation_covariance = [0.0] * 8
    raises(ValueError, octets, message)
    message.orientation_covariance = "123456789"
    raises(TypeError, octets, message)
    message.orientation_covariance = (1, 2, 3, 4, 5, 6, 7, 8, 9)
    assert octets(message)
    message.linear_acceleration = message.orientation
    raises(TypeError, octets, message)
    twist = Twist()
    twist.linear = None
    raises(TypeError, octets, twist)
    raises(ValueError, octets, Int32(2147483648))
    raises(TypeError, octets, Int32("5"))
    raises(TypeError, octets, String(5))


def test_without_garbage():
    if not BOARD:
        return
    import gc

    import micropython

    # Objects are larger where addresses have 64 bits.
    limit = 300 if sys.maxsize < 2**32 else 600
    for source in (imu(), odometry(), Twist(), Int32(5), String("same")):
        buf = octets(source)
        size = len(buf)
        reused = type(source)()
        reused.unpack_into(buf, 0, 0, size)
        stamp = source.header.stamp if hasattr(source, "header") else None
        micropython.heap_lock()
        try:
            if stamp:
                stamp.high = 25939
                stamp.low = 61696
            source.pack_into(buf, 0, 0)
        finally:
            micropython.heap_unlock()
        gc.collect()
        gc.disable()
        before = gc.mem_alloc()
        reused.unpack_into(buf, 0, 0, size)
        allocated = gc.mem_alloc() - before
        gc.enable()
        assert allocated < limit, (type(source), allocated)
