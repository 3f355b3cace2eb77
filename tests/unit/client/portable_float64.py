"""Exact float64 fields. Also runs on MicroPython, with floats of 32 and of 64 bits."""

from support.services import Bench, raised

from uros.client.float64 import Exact, Float64
from uros.wire import ids

try:
    from uros.interfaces.geometry_msgs.msg import Vector3
    from uros.interfaces.nav_msgs.msg import Odometry
    from uros.interfaces.sensor_msgs.msg import NavSatFix
except ImportError:  # MicroPython
    from geometry_msgs.msg import Vector3
    from nav_msgs.msg import Odometry
    from sensor_msgs.msg import NavSatFix

LATITUDE = Float64(501234567, 10000000)
LONGITUDE = Float64(-1790000001, 10000000)
# Computed by CPython: struct.pack("<d", 50.1234567) and struct.pack("<d", -179.0000001)
LATITUDE_OCTETS = bytes.fromhex("6d7cdc6dcd0f4940")
LONGITUDE_OCTETS = bytes.fromhex("e5af3500006066c0")


def packed(message, offset=0):
    """Return the octets of a message that begins at an offset of a larger buffer."""
    buf = bytearray(message.cdr_size() + offset + 8)
    end = message.pack_into(buf, offset, offset)
    assert end - offset == message.cdr_size()
    return bytes(buf[offset:end])


def octets(bits):
    return bits.to_bytes(8, "little")


def test_bits_of_fractions() -> None:
    for numerator, denominator, bits in (
        (0, 1, 0), (0, -5, 0), (1, 1, 0x3FF0000000000000), (-1, 1, 0xBFF0000000000000),
        (1, -1, 0xBFF0000000000000), (-2, -1, 0x4000000000000000),
        (1, 3, 0x3FD5555555555555), (1, 10, 0x3FB999999999999A), (3, 2, 0x3FF8000000000000),
        # Ties go to the even neighbour, and may carry into the exponent.
        (2**53 + 1, 1, 0x4340000000000000), (2**53 + 3, 1, 0x4340000000000002),
        (2**54 - 1, 1, 0x4350000000000000),
        # The largest, the smallest normal, the largest and the smallest subnormal numbers.
        (2**1024 - 2**971, 1, 0x7FEFFFFFFFFFFFFF), (1, 2**1022, 0x0010000000000000),
        (2**52 - 1, 2**1074, 0x000FFFFFFFFFFFFF), (1, 2**1074, 1), (3, 2**1075, 2),
        (1, 2**1075, 0), (1, 2**2000, 0),
    ):  # fmt: skip
        assert Float64(numerator, denominator).bits == bits, (numerator, denominator)
    assert octets(LATITUDE.bits) == LATITUDE_OCTETS
    assert octets(LONGITUDE.bits) == LONGITUDE_OCTETS


def test_invalid_fractions() -> None:
    assert "denominator" in raised(ZeroDivisionError, Float64, 1, 0)
    assert "range" in raised(OverflowError, Float64, 2**1024)
    assert "range" in raised(OverflowError, Float64, 2**1024 - 1)
    assert "integers" in raised(TypeError, Float64, 0.5)
    assert "integers" in raised(TypeError, Float64, 1, 2.0)


def test_fields_of_a_message() -> None:
    fix = NavSatFix(latitude=1.0, longitude=2.0, altitude=4.0)
    for frame, offset in (("", 0), ("gps", 3), ("antenna", 8), ("a", 12)):
        fix.header.frame_id = frame
        plain = packed(fix, offset)
        exact = packed(Exact(fix, longitude=LONGITUDE, latitude=LATITUDE), offset)
        at = plain.index(bytes.fromhex("000000000000f03f0000000000000040"))
        assert exact[at : at + 16] == LATITUDE_OCTETS + LONGITUDE_OCTETS
        assert exact[:at] == plain[:at] and exact[at + 16 :] == plain[at + 16 :]
        assert (fix.latitude, fix.longitude, fix.altitude) == (1.0, 2.0, 4.0)


def test_fields_of_nested_messages() -> None:
    vector = Vector3()
    assert packed(Exact(vector, (vector, "y", LATITUDE))) == bytes(8) + LATITUDE_OCTETS + bytes(8)
    odometry = Odometry()
    plain = packed(odometry)
    exact = packed(
        Exact(
            odometry,
            (odometry.twist.twist.angular, "z", LONGITUDE),
            (odometry.pose.pose.position, "x", LATITUDE),
        )
    )
    first, second = exact.index(LATITUDE_OCTETS), exact.index(LONGITUDE_OCTETS)
    assert first < second
    back = bytearray(exact)
    back[first : first + 8] = back[second : second + 8] = bytes(8)
    assert bytes(back) == plain


def test_invalid_fields() -> None:
    fix = NavSatFix()
    assert "latitude takes a Float64" in raised(TypeError, lambda: Exact(fix, latitude=1.0))
    raised(AttributeError, lambda: Exact(fix, speed=LATITUDE))
    exact = Exact(fix, position_covariance_type=LATITUDE)
    try:
        packed(exact)
    except (TypeError, ValueError):
        pass
    else:
        raise AssertionError("not refused")
    assert fix.position_covariance_type == 0
    names = ["field%d" % i for i in range(101)]
    assert "at most" in raised(ValueError, lambda: Exact(fix, **{name: LATITUDE for name in names}))


def test_publish() -> None:
    bench = Bench()
    publisher = bench.node.create_publisher(NavSatFix, "fix", 10)
    bench.connect()
    assert publisher.publish(Exact(NavSatFix(), latitude=LATITUDE))
    bench.run(100)
    writer_id = publisher.object_id(ids.KIND_DATAWRITER)
    (sample,) = [sample for object_id, sample in bench.agent.samples if object_id == writer_id]
    assert LATITUDE_OCTETS in bytes(sample)
    vector = Vector3()
    raised(TypeError, publisher.publish, Exact(vector, (vector, "x", LATITUDE)))
