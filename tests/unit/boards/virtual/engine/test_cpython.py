"""Programs on CPython: modules, output, time, buses and USB; in this process, on a manual clock."""

import struct
import sys
import textwrap
import time
from datetime import datetime, timedelta, timezone

import pytest

from uros.boards.virtual.engine import cpython
from uros.boards.virtual.engine.syscalls import BoardHost, Reset
from uros.boards.virtual.hardware.board import VirtualBoard
from uros.boards.virtual.hardware.clock import ManualClock
from uros.boards.virtual.models.catalog import find


class Runner:
    """A board whose file system is a folder; keeps the output and tracebacks of the last run."""

    def __init__(self, root):
        self.root = root
        self.board = VirtualBoard(find("ra6m5_sensor_node"), ManualClock())
        self.printed = ""
        self.tracebacks = []
        self.states = []
        self.host = BoardHost(
            self.board, self._print, self.tracebacks.append, lambda *_: None, self.states.append
        )

    def _print(self, text):
        self.printed += text

    def file(self, path, text):
        file = self.root / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(textwrap.dedent(text))

    def run(self, text):
        """Run ``text`` as main.py; return what it printed."""
        self.file("main.py", text)
        self.printed = ""
        self.tracebacks.clear()
        cpython.run(self.root, self.host)
        return self.printed

    def fine(self, text):
        """Run a program that must end without an error; return what it printed."""
        printed = self.run(text)
        assert self.tracebacks == [""], self.tracebacks
        return printed


@pytest.fixture
def runner(tmp_path):
    runner = Runner(tmp_path)
    yield runner
    runner.board.close()


# --- modules --------------------------------------------------------------------------------


def test_modules_come_from_the_board_and_are_discarded_after_the_run(runner):
    runner.file("one.py", "count = 0\n")
    runner.file("pack/__init__.py", "from . import inner\nfrom .inner import name\n")
    runner.file("pack/inner.py", "import sys\nname = __name__\nfrom . import late\n")
    runner.file("pack/late.py", "from .deep.most import value\n")
    runner.file("pack/deep/most.py", "value = 7\n")  # a package without __init__.py
    runner.file("below.py", "def where(): return __file__\n")
    program = """
        import one, pack.inner as inner, pack
        from pack import late
        from below import where
        one.count += 1
        print(one.count, pack.name, inner.name, late.value, where(), __name__)
        import sys
        print('pack.deep.most' in sys.modules, 'pytest' in sys.modules)
    """
    expected = "1 pack.inner pack.inner 7 below.py __main__\nTrue False\n"
    assert runner.fine(program) == expected
    assert runner.fine(program) == expected
    assert "one" not in sys.modules and "pack" not in sys.modules


@pytest.mark.parametrize("name", ["typing", "threading", "subprocess", "uros.boards", "no.where"])
def test_modules_that_a_board_does_not_have_cannot_be_imported(runner, name):
    assert f"ImportError: no module named '{name.partition('.')[0]}'" in (
        runner.run(f"import {name}\n") + runner.tracebacks[0]
    )


def test_a_module_that_failed_is_imported_again(runner):
    runner.file("bad.py", "print('bad')\nraise ValueError('no')\n")
    program = """
        for _ in range(2):
            try:
                import bad
            except ValueError as error:
                print(error)
    """
    assert runner.fine(program) == "bad\nno\nbad\nno\n"


def test_relative_imports_need_a_package(runner):
    runner.run("from . import other\n")
    assert "ImportError: can't perform relative import" in runner.tracebacks[0]


def test_modules_of_micropython_can_be_imported(runner):
    program = """
        import array, binascii, collections, errno, gc, io, json, math, os, random, struct
        from micropython import const, mem_info
        X = const(3)
        mem_info()
        gc.collect()
        print(X, gc.mem_free(), gc.mem_alloc(), errno.ETIMEDOUT > 0)
        import sys
        print(sys.implementation.name, sys.platform, sys.path[0] == "")
        def f(x: Undefined) -> AlsoUndefined: pass
        y: NeitherThis = 1
    """
    assert runner.fine(program) == "3 -1 -1 True\nmicropython virtual True\n"


def test_struct_behaves_as_on_micropython(runner):
    printed = runner.run(
        """
        from array import array
        from struct import pack, pack_into, unpack_from
        doubles = array("d", (0.0, 0.0))
        pack_into("<16s", doubles, 0, memoryview(pack("<2d", 1.5, -2.0) + b"more"))
        octets = bytearray(8)
        pack_into("<8s", octets, 0, doubles)
        print(doubles[0], doubles[1], unpack_from("<d", octets), pack("<8s", doubles) == octets)
        try:
            unpack_from("<d", octets, 1)
        except ValueError:
            print("too short")
        """
    )
    assert printed == "1.5 -2.0 (1.5,) True\ntoo short\n"


def test_the_host_keeps_its_own_time(runner):
    real = time
    runner.fine("import time, select\nassert hasattr(time, 'ticks_ms')\n")
    assert sys.modules["time"] is real and not hasattr(time, "ticks_ms")


# --- printing and the end ----------------------------------------------------------------------


def test_a_traceback_has_the_format_of_micropython(runner):
    runner.file("helper.py", "def fail():\n    raise KeyError('k')\n")
    runner.run("import helper\n\ndef inside():\n    helper.fail()\n\ninside()\n")
    assert runner.tracebacks == [
        "Traceback (most recent call last):\n"
        '  File "main.py", line 6, in <module>\n'
        '  File "main.py", line 4, in inside\n'
        '  File "helper.py", line 2, in fail\n'
        "KeyError: k\n"
    ]


@pytest.mark.parametrize(
    ("expression", "line"),
    [
        ("ValueError()", "ValueError: "),
        ("ValueError('a', 1)", "ValueError: ('a', 1)"),
        ("OSError(19)", "OSError: [Errno 19] ENODEV"),
        ("OSError('words')", "OSError: words"),
        ("Own('x')", "Own: x"),
    ],
)
def test_the_last_line_of_a_traceback(runner, expression, line):
    runner.run(f"class Own(Exception): pass\nraise {expression}\n")
    assert runner.tracebacks[0].splitlines()[-1] == line


def test_no_frame_of_host_or_built_in_modules_is_shown(runner):
    program = """
        import sys
        from machine import I2C
        try:
            I2C(2).writeto(0x50, b"x")
        except OSError as error:
            sys.print_exception(error)
            print(error, error.errno)
    """
    assert runner.fine(program) == (
        'Traceback (most recent call last):\n  File "main.py", line 5, in <module>\n'
        "OSError: [Errno 19] ENODEV\n[Errno 19] ENODEV 19\n"
    )


def test_a_syntax_error_has_its_line(runner):
    runner.run("x = 1\nif\n")
    assert runner.tracebacks == [
        'Traceback (most recent call last):\n  File "main.py", line 2\n'
        "SyntaxError: invalid syntax\n"
    ]


@pytest.mark.parametrize(
    "text", ["import machine\nmachine.reset()\n", "import machine\nmachine.soft_reset()\n",
             "import sys\nsys.exit()\n",
             "import machine\ntry: machine.reset()\nexcept Exception: print('caught')\n"],
)  # fmt: skip
def test_programs_that_ask_for_a_reset(runner, text):
    with pytest.raises(Reset):
        runner.run(text)
    assert not runner.tracebacks and not runner.printed


def test_print_writes_to_the_console_or_to_its_file(runner):
    program = """
        import io, sys
        text = io.StringIO()
        print("a", 1, sep="-", file=text)
        print("b", end="")
        sys.stdout.write(text.getvalue())
    """
    assert runner.fine(program) == "ba-1\n"


# --- time ------------------------------------------------------------------------------------


def test_ticks_and_sleep(runner):
    program = """
        import time
        before = time.ticks_us()
        time.sleep_ms(1500); time.sleep_us(7); time.sleep(0.25); time.sleep_us(-3)
        print(time.ticks_diff(time.ticks_us(), before), time.ticks_ms() - before // 1000)
        print(time.ticks_add(0, -1), time.ticks_diff(0, (1 << 30) - 1), time.ticks_diff(5, 9))
        try:
            time.ticks_add(0, 1 << 29)
        except OverflowError:
            print("overflow")
    """
    assert runner.fine(program) == "1750007 1750\n1073741823 1 -4\noverflow\n"


def test_ticks_wrap_as_small_integers_do(runner):
    runner.board.clock.advance((1 << 30) + 5)
    assert runner.fine("import time\nprint(time.ticks_us(), time.ticks_ms())\n") == "5 1073741\n"


def test_the_epoch_is_2000(runner):
    program = """
        import time
        time.sleep(90061)
        print(time.time(), time.time_ns(), time.localtime())
    """
    expected = "90061 90061000000000 (2000, 1, 2, 1, 1, 1, 6, 2)\n"
    assert runner.fine(program) == expected


def test_the_real_time_clock_can_be_set(runner):
    program = """
        import time
        from machine import RTC
        RTC().datetime((2026, 11, 22, 6, 15, 2, 48, 250000))
        print(RTC().datetime(), time.localtime()[:6], time.ticks_ms())
    """
    expected = "(2026, 11, 22, 6, 15, 2, 48, 250000) (2026, 11, 22, 15, 2, 48) 0\n"
    assert runner.fine(program) == expected
    runner.host.reset()
    runner.board.clock.advance(1_750_000)
    again = "from machine import RTC\nprint(RTC().datetime())\n"
    assert runner.fine(again) == "(2026, 11, 22, 6, 15, 2, 50, 0)\n"


def test_the_calendar_agrees_with_datetime(runner):
    epoch = datetime(2000, 1, 1, tzinfo=timezone.utc)
    moments = [epoch + timedelta(days=d, seconds=d) for d in range(-15000, 60000, 7)]
    for year in (1999, 2000, 2023, 2024, 2100):
        for month, day in ((1, 1), (2, 28), (12, 31)):
            moments.append(datetime(year, month, day, 23, 59, 59, tzinfo=timezone.utc))
    seconds = [int((moment - epoch).total_seconds()) for moment in moments]
    program = f"""
        import time
        for s in {seconds}:
            parts = time.gmtime(s)
            assert time.mktime(parts) == s
            print(*parts)
        print(time.mktime((2023, 14, 31, 24, 60, 60)) - time.mktime((2024, 3, 3, 1, 1, 0)))
    """
    *lines, last = runner.fine(program).splitlines()
    for moment, line in zip(moments, lines, strict=True):
        year, month, day, hour, minute, second, weekday, yearday, _ = moment.timetuple()
        assert line == f"{year} {month} {day} {hour} {minute} {second} {weekday} {yearday}"
    assert last == "0"


# --- buses and pins -----------------------------------------------------------------------------


def test_i2c(runner):
    program = """
        from machine import I2C, Pin
        import time
        i2c = I2C(2, scl=Pin("P415"), sda=Pin("P414"), freq=100000, timeout=100000)
        print(i2c, i2c.scan())
        print(i2c.readfrom_mem(0x13, 0x81, 1), i2c.readfrom(0x13, 1))
        i2c.writeto_mem(0x13, 0x83, b"\\x14")
        buffer = bytearray(1)
        i2c.readfrom_mem_into(0x13, 0x83, buffer)
        print(buffer)
        print(i2c.writevto(0x13, [b"\\x83", bytearray(b"\\x0a")]))
        print(i2c.writeto(0x13, b"\\x83", False))
        i2c.readfrom_into(0x13, buffer)
        print(buffer, len(i2c.readfrom_mem(0x44, 0xF32D, 3, addrsize=16)))
    """
    assert runner.fine(program) == (
        "I2C(2, freq=100000) [19, 68, 103]\nb'!' b'\\x00'\nbytearray(b'\\x14')\n2\n1\n"
        "bytearray(b'\\n') 3\n"
    )
    bus = runner.board.i2c[2]
    assert (bus.frequency, bus.timeout_us) == (100_000, 100_000)


@pytest.mark.parametrize(
    ("fault", "error"),
    [("sht3x:absent", "ENODEV"), ("sht3x:nack", "EIO"), ("sht3x:stuck", "ETIMEDOUT")],
)
def test_errors_of_a_bus(runner, fault, error):
    runner.board.happen(fault)
    program = f"""
        import errno
        from machine import I2C
        try:
            I2C(2, timeout=1000).writeto(0x44, b"\\x2c\\x06")
        except OSError as error:
            print(error, error.errno == errno.{error}, error.args[0] == errno.{error})
    """
    assert runner.fine(program).endswith(f"] {error} True True\n")


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("machine.I2C(7)", "ValueError: I2C(7) doesn't exist"),
        ("machine.Pin('P999')", "ValueError: invalid pin"),
        ("machine.Pin('P999', machine.Pin.OUT, value=1)", "ValueError: invalid pin"),
        ("machine.I2C(2).readfrom(200, 1)", "OSError: [Errno 22] EINVAL"),
    ],
)
def test_pins_and_buses_that_the_board_does_not_have(runner, text, error):
    runner.run(f"import machine\n{text}\n")
    last = runner.tracebacks[0].splitlines()[-1]
    assert last == error or last.startswith(f"{error}: this virtual board has ")


def test_pins(runner):
    program = """
        from machine import Pin
        led = Pin("P006", Pin.OUT, value=1)
        print(led, led.value(), led(), led.name())
        led.off(); print(led.value())
        led.on(); led.toggle(); print(led.value())
        led(1)
        print(Pin(led).value(), Pin("P005", Pin.IN, Pin.PULL_UP).value())
    """
    assert runner.fine(program) == "Pin(P006) 1 1 P006\n0\n0\n1 1\n"
    assert runner.board.pins["P006"].value() == 1


def test_unique_id_frequency_and_sleep(runner):
    program = """
        import machine
        print(machine.unique_id(), machine.freq())
        machine.enable_irq(machine.disable_irq())
        machine.lightsleep(2); machine.idle()
        import time
        print(time.ticks_us())
    """
    assert runner.fine(program) == f"{runner.board.unique_id!r} 200000000\n3000\n"


# --- USB ---------------------------------------------------------------------------------------

OPEN = """
import errno, machine, os, select, time, usb.device
from usb.device.cdc import CDCInterface
cdc = CDCInterface(timeout=0)
usb.device.get().init(cdc, manufacturer_str="Maker", product_str="Thing", serial_str="7",
    id_vendor=0x1234, id_product=0x5678, max_power_ma=100)
assert not cdc.is_open()
while not cdc.is_open():
    machine.idle()
"""


def test_the_host_gets_the_descriptors_of_the_firmware(runner):
    runner.fine(OPEN + "assert usb.device.get().active()\n")
    identity = runner.board.usb.identity
    assert (identity.vendor, identity.product, identity.serial) == (0x1234, 0x5678, "7")
    assert (identity.manufacturer_name, identity.product_name) == ("Maker", "Thing")
    assert (identity.self_powered, identity.milliamperes) == (False, 100)
    assert (identity.notification, identity.data_out, identity.data_in) == (0x81, 0x02, 0x82)
    assert runner.states == ["attached", "configured"]


def test_the_default_descriptors_are_micropythons(runner):
    runner.fine(
        "import usb.device, time\nfrom usb.device.cdc import CDCInterface\n"
        "cdc = CDCInterface()\nusb.device.get().init(cdc)\n"
        "time.sleep_ms(10)\nassert cdc.is_open()\n"
    )
    identity = runner.board.usb.identity
    assert (identity.manufacturer_name, identity.serial) == ("MicroPython", "")
    assert (identity.vendor, identity.self_powered) == (0xF055, True)


def test_switching_usb_off(runner):
    runner.fine(OPEN + "usb.device.get().active(False)\nassert not cdc.is_open()\n")
    assert runner.states == ["attached", "configured", "detached"]


def test_a_wait_ends_at_its_state_or_its_timeout(runner):
    from uros.boards.virtual.shims import _ops as ops

    runner.fine(OPEN)
    clock = runner.board.clock
    for wanted, state, us in (
        (ops.USB_OPEN, ops.USB_OPEN, 0),  # in this state already
        (ops.USB_READABLE, ops.USB_OPEN, 70_000),
        (ops.USB_WRITABLE, ops.USB_OPEN, 70_000),
    ):
        before = clock.world_us()
        assert runner.host.call(ops.USB_WAIT, struct.pack("<IB", 70_000, wanted)) == state
        assert us <= clock.world_us() - before <= us + 1


def test_descriptors_of_a_driver(runner):
    """A driver may write its own descriptors and change them until the device is enabled."""
    program = """
        import time, usb.device
        from usb.device.cdc import CDCInterface
        class Own(CDCInterface):
            def desc_cfg(self, desc, itf_num, ep_num, strs):
                desc.interface(0, 1, 2, 2)
                desc.extend(bytes((5, 0x24, 0, 0x10, 1, 5, 0x24, 6, 0, 1)))
                desc.endpoint(0x83, "interrupt", 16, 255)
                desc.interface(1, 2, 10)
                desc.endpoint(0x01, "bulk", 64, 0)
                desc.endpoint(0x82, "bulk", 64, 0)
                self.written = desc.b
        cdc, device = Own(), usb.device.get()
        device.config(cdc, max_power_ma=100)
        cdc.written[7] |= 0x40
        device.active(True)
        time.sleep_ms(10)
        print(cdc.is_open())
    """
    assert runner.fine(program) == "True\n"
    identity = runner.board.usb.identity
    assert (identity.self_powered, identity.notification, identity.data_out) == (True, 0x83, 1)


def test_a_host_that_refuses_the_descriptors(runner):
    program = """
        import time, usb.device
        from usb.device.cdc import CDCInterface
        class Bad(CDCInterface):
            def num_itfs(self): return 3
        cdc = Bad()
        usb.device.get().init(cdc)
        time.sleep_ms(10)
        print(cdc.is_open())
    """
    assert runner.fine(program) == "False\n"
    assert "interfaces" in runner.board.usb.error


ON_HOST = """
import os
host = os.open({path!r}, os.O_RDWR | os.O_NOCTTY)
"""


def test_bytes_both_ways(runner):
    program = (
        OPEN
        + ON_HOST.format(path=str(runner.board.usb.path))
        + """
assert cdc.read(5) is None and cdc.readinto(bytearray(3)) is None and cdc.dtr
os.write(host, b"hello board")
poll = select.poll()
poll.register(cdc, select.POLLIN)
assert poll.poll(1000) == [(cdc, select.POLLIN)]
print(cdc.read(5))
buffer = bytearray(4)
print(cdc.readinto(buffer), buffer, cdc.read(), poll.poll(0))
print(cdc.write(b"to the host"), os.read(host, 100))
print(cdc.ioctl(3, 0x15), cdc.ioctl(99, 0), cdc.flush())
os.close(host)
"""
    )
    assert runner.fine(program) == (
        "b'hello'\n4 bytearray(b' boa') b'rd' []\n11 b'to the host'\n4 -22 None\n"
    )


def test_reads_and_writes_wait_for_their_timeout(runner):
    program = (
        OPEN
        + ON_HOST.format(path=str(runner.board.usb.path))
        + """
cdc.init(timeout=1000)
os.write(host, b"ab")
start = time.ticks_ms()
print(cdc.read(3), time.ticks_diff(time.ticks_ms(), start))
os.close(host)
start = time.ticks_ms()
print(cdc.write(b"nobody"), time.ticks_diff(time.ticks_ms(), start))
"""
    )
    assert runner.fine(program) == "b'ab' 1000\n0 1000\n"


def test_a_poll_ends_at_its_timeout(runner):
    program = (
        OPEN
        + """
poll = select.poll()
poll.register(cdc)
poll.modify(cdc, select.POLLIN)
start = time.ticks_ms()
print(poll.poll(2500), time.ticks_diff(time.ticks_ms(), start))
poll.modify(cdc, select.POLLHUP)
print(list(poll.ipoll(0)))
usb.device.get().active(False)
print(poll.poll()[0][1] == select.POLLHUP, cdc.ioctl(3, 0xff))
poll.unregister(cdc)
try:
    poll.modify(cdc, 1)
except OSError as error:
    print(error.args[0])
"""
    )
    assert runner.fine(program) == "[] 2500\n[]\nTrue 16\n2\n"


def test_callbacks_of_an_interface(runner):
    program = OPEN.replace("CDCInterface(", "Own(").replace(
        "cdc = Own", """
class Own(CDCInterface):
    def on_open(self):
        super().on_open(); print("opened")
    def on_reset(self):
        super().on_reset(); print("reset")
cdc = Own"""
    ) + "usb.device.get().active(False)\n"  # fmt: skip
    assert runner.fine(program) == "opened\nreset\n"


# --- system calls ----------------------------------------------------------------------------


def test_unknown_and_invalid_operations_are_refused(runner):
    from uros.boards.virtual.shims import _ops as ops

    for op, data in ((99, b""), (ops.I2C_TRANSFER, b"\2"), (ops.PIN_GET, b"P999")):
        with pytest.raises(OSError, match="Errno 22"):
            runner.host.call(op, data)


def test_the_reset_button_waits_for_an_operation_but_not_for_a_sleep(runner):
    from uros.boards.virtual.shims import _ops as ops

    bus = runner.board.i2c[2]
    resets = []

    def pressed_while_reading(*_):
        runner.host.ask_reset()
        resets.append(True)

    bus.on_read = pressed_while_reading
    with pytest.raises(Reset):
        runner.host.call(ops.I2C_TRANSFER, struct.pack("<BBBH", 2, 0x13, 1, 1))
    assert resets
    runner.host.reset()

    def pressed_while_asleep(us):
        with pytest.raises(Reset):
            runner.host.ask_reset()
        raise Reset

    runner.board.clock.sleep_us = pressed_while_asleep
    with pytest.raises(Reset):
        runner.host.call(ops.SLEEP, struct.pack("<Q", 5))
    runner.host.reset()
    with pytest.raises(Reset):
        runner.host.ask_reset()  # while the program itself runs


@pytest.mark.parametrize(
    "wait", [("SLEEP", struct.pack("<Q", 3600 * 10**6)), ("USB_WAIT", struct.pack("<IB", 10**6, 1))]
)
def test_the_reset_button_is_not_lost_when_a_wait_is_about_to_begin(runner, monkeypatch, wait):
    from uros.boards.virtual.shims import _ops as ops

    monkeypatch.setattr(runner.board, "advance", runner.host.ask_reset)
    before = runner.board.clock.world_us()
    with pytest.raises(Reset):
        runner.host.call(getattr(ops, wait[0]), wait[1])
    assert runner.board.clock.world_us() == before


def test_a_reset_disables_usb_and_restarts_the_ticks(runner):
    runner.fine(OPEN)
    runner.host.reset()
    assert runner.states[-1] == "detached"
    assert runner.fine("import time\nprint(time.ticks_us(), time.time_ns() > 0)\n") == "0 True\n"
