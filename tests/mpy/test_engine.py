"""Tests that both engines run a program alike, and tests of the MicroPython engine alone."""

import os
import select
import textwrap

import pytest
from mpy.harness import INSTALLED

from uros.boards.virtual.engine.runner import RunningBoard

BOARD = "ra6m5_sensor_node"
ENGINES = ("cpython", "micropython")


@pytest.fixture(autouse=True)
def installed(monkeypatch):
    monkeypatch.setenv("UROS_MICROPYTHON", str(INSTALLED))


@pytest.fixture
def program(tmp_path):
    """Return a function that writes a folder of files; the first is main.py."""

    def make(main, **others):
        folder = tmp_path / "program"
        folder.mkdir(exist_ok=True)
        for name, text in {"main": main, **others}.items():
            (folder / f"{name}.py").write_text(textwrap.dedent(text))
        return folder

    return make


ALL = """
    import errno, gc, machine, micropython, select, struct, sys, time
    import usb.device
    from machine import I2C, Pin
    from usb.device.cdc import CDCInterface
    import helper
    from sensor_msgs.msg import Temperature

    print(__name__, helper.__name__, sys.implementation.name, sys.path[0] == "")
    print(machine.unique_id(), machine.freq(), time.gmtime(86400 * 366), time.time() < 100)
    print(time.mktime((2024, 2, 30, 12, 0, 0, 0, 0)), time.ticks_diff(3, time.ticks_add(3, -7)))
    before = time.ticks_us()
    time.sleep_ms(3)
    print(3000 <= time.ticks_diff(time.ticks_us(), before) < 2000000)

    i2c = I2C(2, scl=Pin("P415"), sda=Pin("P414"), freq=400000, timeout=100000)
    print(i2c, i2c.scan(), i2c.readfrom_mem(0x13, 0x81, 1), i2c.writeto(0x67, bytearray(b"\\0")))
    buffer = bytearray(3)
    i2c.readfrom_mem_into(0x44, 0xF32D, buffer, addrsize=16)
    print(len(buffer), i2c.writevto(0x13, (b"\\x83", b"\\x05")), i2c.readfrom_mem(0x13, 0x83, 1))
    for call in (
        lambda: i2c.readfrom(0x50, 1), lambda: I2C(5), lambda: Pin("P999"),
        lambda: i2c.readfrom(300, 1), helper.fail,
    ):
        try:
            call()
        except Exception as error:
            text = str(error).split(": ")[0]
            print(type(error).__name__, text, isinstance(error, OSError) and error.errno)

    led = Pin("P006", Pin.OUT, value=1)
    led.toggle()
    print(led, led.value())
    led(1)
    print(led())

    message = Temperature()
    message.temperature = 23.5
    print(message.temperature, message.header.frame_id == "")

    class Port(CDCInterface):
        def on_open(self):
            super().on_open()
            print("opened")

    port = Port(timeout=0)
    usb.device.get().init(port, product_str="Thing", id_vendor=1, id_product=2)
    while not port.is_open():
        machine.idle()
    poll = select.poll()
    poll.register(port, select.POLLIN)
    print(poll.poll(1), port.read(1), port.write(b"nobody listens"))
    port.init(timeout=20000)
    print(port.read(9))
    print(port.write(memoryview(b"xhello back")[1:]))
    try:
        helper.fail()
    except ValueError as error:
        sys.print_exception(error)
    print("the end", end="")
    helper.deeper()
"""
HELPER = """
    from micropython import const
    _WORDS = const("no luck")

    def fail():
        raise ValueError(_WORDS)

    def deeper():
        import machine
        machine.I2C(2).readfrom(0x33, 1)
"""
EXPECTED = r"""
__main__ helper micropython True
b'RA6M5\x00\x00\x00\x00\x00\x00\x00\x00\x00\x00\x00' 200000000 (2001, 1, 1, 0, 0, 0, 0, 1) True
762609600 7
True
I2C(2, freq=400000) [19, 68, 103] b'!' 1
3 2 b'\x05'
OSError [Errno 19] ENODEV 19
ValueError I2C(5) doesn't exist False
ValueError invalid pin False
OSError [Errno 22] EINVAL 22
ValueError no luck False
Pin(P006) 0
1
23.5 True
opened
[] None 0
b'from host'
10
Traceback (most recent call last):
  File "main.py", line 57, in <module>
  File "helper.py", line 6, in fail
ValueError: no luck
the end
Traceback (most recent call last):
  File "main.py", line 61, in <module>
  File "helper.py", line 10, in deeper
OSError: [Errno 19] ENODEV
"""


@pytest.mark.parametrize("engine", ENGINES)
def test_a_program_prints_the_same_on_both_engines(program, engine):
    with RunningBoard(program(ALL, helper=HELPER), BOARD, engine) as board:
        lines = [board.console.get(timeout=30)]
        while "None 0" not in lines[-1]:
            lines.append(board.console.get(timeout=30))
        line = os.open(board.path, os.O_RDWR | os.O_NOCTTY)
        os.write(line, b"from host")
        assert select.select([line], [], [], 30)[0]
        assert os.read(line, 100) == b"hello back"
        traceback = board.wait_end()
        os.close(line)
        while not board.console.empty():
            lines.append(board.console.get())
        assert traceback.endswith("ENODEV\n")
    assert lines == EXPECTED.strip().splitlines()


@pytest.mark.parametrize("engine", ENGINES)
def test_a_program_resets_its_board(program, engine):
    folder = program("""
        import machine, sys, time
        print("started", time.ticks_ms() < 30000)
        try:
            machine.reset()
        except Exception:
            print("caught")
    """)
    with RunningBoard(folder, BOARD, engine) as board:
        for _ in range(3):
            assert board.console.get(timeout=30) == "started True"
        assert board.resets >= 2


@pytest.mark.parametrize("stuck", ["while True: pass", "time.sleep(3600)", "select.poll().poll()"])
def test_a_stuck_program_can_be_reset_and_ended(program, stuck):
    folder = program(f"import time, select\nprint('started')\n{stuck}\n")
    with RunningBoard(folder, BOARD, "micropython") as board:
        board.wait("started")
        board.reset()
        board.wait("started")
        process = board._process
    assert process.returncode == 0  # the process ended by itself


SLICED = """
    import gc, time
    kept = []
    count = 0

    def start():
        print("start", __name__)

    def step():
        global count
        count += 1
        rubbish = bytearray(100000)
        time.sleep_ms(1)
        if count == 200:
            print("many")
        if count == 400:
            raise ValueError("enough")

    def main():
        print("nobody calls this here")
        start()
        while True:
            step()

    if __name__ == "__main__":
        main()
"""


def test_garbage_is_collected_between_steps(program):
    """The engine collects between steps: 200 steps make 20 MB of garbage, the heap stays small."""
    with RunningBoard(program(SLICED), BOARD, "micropython", measure=True) as board:
        assert board.console.get(timeout=30) == "start main"
        board.wait("many")
        heap = board.heap()
        assert 0 < heap.used < 8000
        assert 100_000 < heap.peak < 130_000
        assert board.wait_end().endswith("ValueError: enough\n")
        assert board.heap().used < 10_000  # the heap can be measured after the end
        assert board.heap().peak < 10_000  # nothing has run since the last request


@pytest.mark.parametrize("names", ["one, two", "(\n        one,\n        two,\n    )"])
def test_garbage_is_collected_after_imports(program, names):
    """A collection follows each form of an import, as on a board with little memory."""
    text = f"    from wasteful import {names}\n    bytearray(100000)\n" + SLICED
    wasteful = "bytearray(60000)\none = two = 1\n"
    with RunningBoard(
        program(text, wasteful=wasteful), BOARD, "micropython", measure=True
    ) as board:
        board.wait("many")
        assert 100_000 < board.heap().peak < 130_000


def test_the_heap_includes_live_objects(program):
    sliced = SLICED.replace("rubbish = bytearray(100000)", "kept.append(bytearray(1000))")
    with RunningBoard(program(sliced), BOARD, "micropython") as board:
        board.wait("many")
        assert board.heap().used > 200_000


def test_bytecode_has_the_tracebacks_of_its_source(program):
    folder = program("import helper\nhelper.fail()\n", helper=HELPER)
    with RunningBoard(folder, BOARD, "micropython", form="mpy") as board:
        assert board.wait_end().endswith(
            '  File "helper.py", line 6, in fail\nValueError: no luck\n'
        )


@pytest.mark.parametrize("engine", ENGINES)
def test_sys_exit_starts_the_program_again(program, engine):
    folder = program("import sys\nprint('started')\nsys.exit()\n")
    with RunningBoard(folder, BOARD, engine) as board:
        board.wait("started")
        board.wait("started")
        assert not board.ended


@pytest.mark.skipif(not os.path.exists("/proc"), reason="not on this platform: needs /proc")
def test_a_killed_micropython_is_reported(program):
    folder = program("print('started')\nimport time\nwhile True: time.sleep_ms(5)\n")
    with RunningBoard(folder, BOARD, "micropython") as board:
        board.wait("started")
        with open(f"/proc/{board._process.pid}/task/{board._process.pid}/children") as file:
            os.kill(int(file.read().split()[0]), 9)
        board.wait("MicroPython has ended")
        board.reset()
        board.wait("started")
