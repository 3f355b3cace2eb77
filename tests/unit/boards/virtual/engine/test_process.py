"""A board in a process of its own: its events, its commands and its end."""

import os
import queue
import select
import signal
import subprocess
import sys
import textwrap
import threading
import time

import pytest

from uros.agent.transports.baud import set_baud_rate
from uros.boards.virtual.engine import process as engine
from uros.boards.virtual.engine.runner import BoardGone, RunningBoard, StartError
from uros.boards.virtual.hardware.board import FaultError
from uros.boards.virtual.models.catalog import BoardError
from uros.transport.serial_host import DevicePort

BOARD = "ra6m5_sensor_node"


@pytest.fixture
def program(tmp_path):
    """Return a function that makes a folder with a main.py."""

    def make(text):
        folder = tmp_path / "program"
        folder.mkdir()
        (folder / "main.py").write_text(textwrap.dedent(text))
        return folder

    return make


SERIAL = """
    import machine, time, usb.device
    from usb.device.cdc import CDCInterface
    cdc = CDCInterface(timeout=0)
    usb.device.get().init(cdc)
    print("started")
"""
ECHO = (
    SERIAL
    + """
    import select
    poll = select.poll()
    poll.register(cdc, select.POLLIN)
    while True:
        cdc.is_open()
        if poll.poll(20):
            cdc.write(cdc.read(64).upper())
"""
)


def test_a_program_from_its_first_line_to_its_end(program):
    folder = program("""
        from std_msgs.msg import Int32
        from machine import I2C
        print("value", Int32(data=5).data, end="")
        I2C(2).readfrom_mem(0x13, 0x81, 1)
        raise ValueError("over")
    """)
    with RunningBoard(folder, BOARD, reads=True) as board:
        before = time.monotonic_ns()
        traceback = board.wait_end()
        assert traceback == (
            'Traceback (most recent call last):\n  File "main.py", line 6, in <module>\n'
            "ValueError: over\n"
        )
        assert board.ended
        assert board.wait("value") == "value 5"
        assert board.wait("ValueError") == "ValueError: over"
        address, ns = board.reads.get(timeout=5)
        assert address == 0x13 and abs(ns - before) < 30e9
        with pytest.raises(TimeoutError, match="no line with 'never'"):
            board.wait("never", 0.01)


def test_on_read_is_called_for_each_i2c_read(program):
    folder = program("from machine import I2C\nI2C(2).readfrom(0x13, 1)\nI2C(2).scan()\n")
    addresses = []
    with RunningBoard(folder, BOARD, on_read=lambda address, _: addresses.append(address)) as board:
        assert board.wait_end() == ""
    assert addresses == [0x13] and board.reads.empty()


def test_the_line_is_a_terminal_at_the_requested_path(program, tmp_path):
    link = tmp_path / "tty"
    with RunningBoard(program(ECHO), BOARD, link=link) as board:
        assert board.path == link
        board.wait_usb("configured")
        line = os.open(link, os.O_RDWR | os.O_NOCTTY)
        os.write(line, b"hello")
        assert select.select([line], [], [], 10)[0]
        assert os.read(line, 100) == b"HELLO"
        board.happen("usb:unplug")
        assert board.usb == "detached" or board.wait_usb("detached") is None
        assert not link.is_symlink()
        assert select.select([line], [], [], 10)[0]
        with pytest.raises(OSError):
            os.write(line, b"anybody?")
        os.close(line)
        board.happen("usb:plug")
        board.wait_usb("configured")
        assert link.is_symlink()
    assert not link.is_symlink()
    assert board.ended


def test_usb_states_are_reported_without_calls_of_the_program(program):
    """On a board with a USB bridge chip, each state is reported though the program only sleeps."""
    folder = program("import time\nwhile True:\n    time.sleep_ms(50)\n")
    with RunningBoard(folder, "esp32_publisher") as board:
        board.wait_usb("configured")
        board.happen("usb:unplug")
        board.wait_usb("detached")
        board.happen("usb:plug")
        board.wait_usb("configured")


def test_a_refused_usb_device_ends_the_wait_for_it(program):
    folder = program("""
        import time, usb.device
        from usb.device.cdc import CDCInterface
        class Bad(CDCInterface):
            def num_itfs(self): return 3
        usb.device.get().init(Bad())
        while True:
            time.sleep_ms(50)
    """)
    with RunningBoard(folder, BOARD) as board:
        with pytest.raises(StartError, match="the board's USB: .*interfaces"):
            board.wait_usb("configured")
        assert board.usb == "attached"
        board.happen("usb:unplug")
        board.wait_usb("detached")


def test_faults_at_the_start_and_while_the_program_runs(program):
    folder = program("""
        import time
        from machine import I2C
        i2c = I2C(2)
        last = 0
        while True:
            try:
                i2c.readfrom(0x67, 1)
                now = "read"
            except OSError as error:
                now = str(error)
            if now != last:
                print(now)
            last = now
            time.sleep_ms(1)
    """)
    with RunningBoard(folder, BOARD, happen=["mcp9600:absent"]) as board:
        board.wait("ENODEV")
        board.happen("mcp9600:off")
        board.wait("read")
        board.happen("bus:stuck")
        board.wait("ETIMEDOUT")
        with pytest.raises(FaultError, match="mcp9600:nack"):
            board.happen("mcp9600:sulking")


def test_a_program_resets_its_board(program):
    folder = program(
        SERIAL
        + """
    while not cdc.is_open():
        machine.idle()
    machine.reset()
    """
    )
    with RunningBoard(folder, BOARD) as board:
        for _ in range(3):
            board.wait("started")
        assert board.resets >= 2


@pytest.mark.parametrize(
    "stuck",
    ["while True: pass", "time.sleep(3600)", "select.poll().poll()",
     "while True:\n    try: time.sleep(3600)\n    except Exception: pass"],
    ids=["loop", "sleep", "poll", "stubborn"],
)  # fmt: skip
def test_reset_and_stop_end_any_program(program, stuck):
    folder = program(f"import time, select\nprint('started')\n{stuck}\n")
    with RunningBoard(folder, BOARD) as board:
        board.wait("started")
        board.reset()
        board.wait("started")
        process = board._process
    assert process.returncode == 0  # it ended by itself and was not killed


def test_reset_after_the_end_of_the_program(program):
    with RunningBoard(program("print('once')\n"), BOARD) as board:
        board.wait_end()
        board.wait("once")
        board.reset()
        board.wait("once")
        board.wait_end()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
def test_a_signal_ends_the_board_and_removes_its_link(program, tmp_path, number):
    link = tmp_path / "tty"
    with RunningBoard(program(ECHO), BOARD, link=link) as board:
        board.wait_usb("configured")
        os.kill(board._process.pid, number)
        with pytest.raises(BoardGone):
            board.wait("never")
        assert not link.is_symlink()
        with pytest.raises(BoardGone):
            board.happen("usb:unplug")
        with pytest.raises(BoardGone):
            board.wait_usb("suspended")


PARENT = """
import sys
from uros.boards.virtual.engine.runner import RunningBoard
board = RunningBoard(sys.argv[1], sys.argv[2], link=sys.argv[3])
board.start()
board.wait_usb("configured")
print(board._process.pid, flush=True)
sys.stdin.read()
"""


@pytest.mark.skipif(not hasattr(os, "pidfd_open"), reason="not on this platform: needs pidfd_open")
def test_the_process_ends_with_its_parent(program, tmp_path):
    link = tmp_path / "tty"
    parent = subprocess.Popen(
        [sys.executable, "-c", PARENT, program(ECHO), BOARD, link],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    child = os.pidfd_open(int(parent.stdout.readline()))
    assert link.is_symlink()
    parent.kill()
    parent.communicate()
    assert select.select([child], [], [], 10)[0]
    os.close(child)
    assert not link.is_symlink()


@pytest.mark.parametrize(
    ("options", "error", "words"),
    [
        ({"happen": ["sht3x:sulking"]}, StartError, "there is no sht3x:sulking"),
        ({"link": __file__}, StartError, "left alone"),
        ({"link": f"{__file__}.d/link"}, StartError, "test_process.py.d: create it"),
        # Nobody can make links there.
        ({"link": "/proc/uros", "board": "esp32_button_led"}, StartError, "USB: no line"),
        ({"board": "nothing"}, BoardError, "there are ra6m5_sensor_node"),
        ({"board": None}, BoardError, "there are ra6m5_sensor_node"),
        ({"engine": "micropython", "where": "/nowhere"}, StartError, "UROS_MICROPYTHON"),
    ],
)
def test_boards_that_do_not_start(program, monkeypatch, options, error, words):
    options = dict({"board": BOARD}, **options)
    if "where" in options:
        monkeypatch.setenv("UROS_MICROPYTHON", options.pop("where"))
    with pytest.raises(error, match=words):
        RunningBoard(program("print(1)\n"), **options).start()


def test_a_program_that_cannot_be_built(program, tmp_path):
    with pytest.raises(StartError, match="main.py:1"):
        RunningBoard(program("import nothing_of_that_name\n"), BOARD).start()
    with pytest.raises(StartError, match="no such folder"):
        RunningBoard(tmp_path / "not there", BOARD).start()


def test_stopping_twice_and_a_board_that_was_never_started(program):
    board = RunningBoard(program("print(1)\n"), BOARD)
    board.stop()
    with pytest.raises(BoardGone):
        board.reset()
    board.start()
    board.stop()
    board.stop()


def test_events_instead_of_queues(program):
    events = []
    folder = program("print('a')\n")
    with RunningBoard(folder, BOARD, on_event=events.append) as board:
        board.wait_end()
    assert [event["event"] for event in events if event["event"] != "part"] == [
        "ready", "console", "ended", "gone",
    ]  # fmt: skip
    leds = [(event["name"], event["shows"]) for event in events if event["event"] == "part"]
    assert leds == [("led_blue", "off"), ("led_green", "off"), ("led_red", "off")]
    assert board.console.empty()


def test_a_heap_request_waits_for_the_engine(program, monkeypatch):
    calls = []

    class Engine:
        def __init__(self, root, host, measure):
            calls.append("begun")

        def ask_heap(self):
            calls.append("heap")

        def run(self):
            calls.append("runs")

        def stop(self):
            pass

        close = stop

    monkeypatch.setattr(engine, "MicroPythonEngine", Engine)
    reading, writing = os.pipe()
    options = engine.Options(str(program("")), BOARD, engine="micropython")
    process = engine.BoardProcess(options, reading, writing)
    try:
        process._ask_heap()
        process._run_program(None, None)
        process._run_program(None, None)
    finally:
        process.close()
        os.close(reading)
        os.close(writing)
    assert calls == ["begun", "heap", "runs", "begun", "runs"]


FAULTS = """
    import sys
    from sensor_msgs.msg import BatteryState, Imu
    from std_msgs.msg import String, UInt8
    from uros.interfaces import dynamic
    greenhouse = dynamic.load("my_msgs/msg/Greenhouse", "float32 soil\\nuint8 doors")
    kinds = {"battery": BatteryState, "imu": Imu, "octet": UInt8, "text": String}
    kinds["made"] = greenhouse
    def attempt(kind, path, value):
        message = kinds[kind]()
        try:
            *inside, name = path.split(".")
            at = message
            for field in inside:
                at = getattr(at, field)
            setattr(at, name, value)
            message.pack_into(bytearray(1000), 0, 0)
            print("packed", getattr(at, name))
        except Exception as error:
            sys.print_exception(error)
    for i in range(3):
        attempt("battery", "volts", 7.4 + i)
        attempt("imu", "orientation.a", 1.0)
        attempt("imu", "header.stamp.sek", 1)
        attempt("octet", "data", 300 + i)
        attempt("text", "data", i)
        attempt("made", "door", 1)
        attempt("made", "doors", 256 + i)
        attempt("imu", "orientation.w", 1.0)
        attempt("imu", "header.stamp.sec", 1234567890)
        attempt("battery", "voltage", 7.5)
        print("round", i)
"""


@pytest.mark.parametrize("engine_name", ["cpython", "micropython"])
def test_an_unknown_field_and_an_invalid_value_are_reported_once(program, engine_name):
    """The build cannot see these names. Valid fields are packed in every round."""
    lines = []
    with RunningBoard(program(FAULTS), BOARD, engine_name) as board:
        while "round 2" not in (line := board.console.get(timeout=30)):
            lines.append(line)
    errors = [line.partition("Error: ")[2] for line in lines if "Error: " in line]
    assert errors == [
        "sensor_msgs/msg/BatteryState has no field volts; did you mean voltage?",
        "geometry_msgs/msg/Quaternion has no field a; it has x, y, z, w",
        "builtin_interfaces/msg/Time has no field sek; did you mean sec?",
        "std_msgs/msg/UInt8.data: 300 is out of range 0 to 255",
        "std_msgs/msg/String.data: expected string, got int",
        "my_msgs/msg/Greenhouse has no field door; did you mean doors?",
        "my_msgs/msg/Greenhouse.doors: 256 is out of range 0 to 255",
    ]
    good = ["packed 1.0", "packed 1234567890", "packed 7.5"]
    assert [line for line in lines if line.startswith("packed")] == 3 * good
    assert sum(line.startswith("Traceback") for line in lines) == len(errors)


@pytest.mark.parametrize("engine_name", ["cpython", "micropython"])
def test_a_virtual_board_has_the_messages_of_ros_distro(program, engine_name, monkeypatch):
    monkeypatch.setenv("ROS_DISTRO", "humble")
    text = """
        from sensor_msgs.msg import Range
        fields = [hasattr(Range(), name) for name in ("variance", "range")]
        print("octets", Range().cdr_size(), fields)
    """
    with RunningBoard(program(text), BOARD, engine_name) as board:
        board.wait("octets 32 [False, True]")


UART_ECHO = """
    from machine import UART
    uart = UART(2, 9600, timeout=0)
    while True:
        uart.wait(1000)
        data = uart.read(64)
        if data:
            uart.write(data.upper())
"""


def test_both_ends_of_a_line_need_the_same_baud_rate(program):
    """The program on the host sets the rate of the line, as that of a real adapter."""
    told = []
    differ = threading.Event()

    def on_event(event):
        if event["event"] == "baud":
            told.append((event["board"], event["line"]))
            differ.set()

    with RunningBoard(program(UART_ECHO), "esp32_publisher", on_event=on_event) as board:
        assert board.baud == 115200
        port = DevicePort(str(board.path), 115200)
        port.open()
        assert differ.wait(20) and told == [(9600, 115200)]
        port.write(b"hello")
        assert len(answer(port, 5)) == 5  # noise
        set_baud_rate(port.fd, 9600)
        port.write(b"hello")
        heard = answer(port, 5)
        # What the board had received at the wrong rate may come first.
        while not heard.endswith(b"HELLO"):
            heard += answer(port, 1)
        port.close()


SWAPPED = """
    from machine import Pin, UART
    for pins in ({"tx": 99}, {"rx": "LED"}):
        try:
            UART(2, 115200, **pins)
        except ValueError as error:
            print("refused", error)
    uart = UART(2, 115200, tx=16, rx=Pin(17), timeout=0)
    uart.write(b"lost")
    uart.wait(200)
    print("read", uart.any(), uart.read(64))
    uart = UART(2, 115200, tx=Pin(17), rx=16, timeout=0)
    uart.write(b"found")
    print("again")
    uart.wait(30000)
"""


@pytest.mark.parametrize("engine_name", ["cpython", "micropython"])
def test_the_line_is_dead_at_other_pins_and_the_console_says_so(program, engine_name):
    with RunningBoard(program(SWAPPED), "esp32_publisher", engine_name) as board:
        port = DevicePort(str(board.path), 115200)
        port.open()
        port.write(b"nobody hears this")
        assert "invalid pin: this virtual board has no pin '99'" in board.wait("refused")
        assert "no pin 'LED'" in board.wait("refused")
        assert "tx=16, rx=17 (swapped)" in board.wait("UART(2) has")
        board.wait("read 0 None")
        while (line := board.console.get(timeout=30)) != "again":
            assert "UART(2) has" not in line
        assert answer(port, 5) == b"found"
        port.close()


def answer(port, size):
    data = b""
    while len(data) < size:
        port.wait(20_000)
        chunk = port.read(4096)
        assert chunk, f"only {data!r} of {size} octets came"
        data += chunk
    return data


@pytest.mark.skipif(not os.path.exists("/proc"), reason="not on this platform: needs /proc")
def test_an_idle_board_sleeps_until_something_happens():
    """Its process wakes some tens of times a second; polling its UART would wake it a thousand."""
    blinks = queue.Queue()

    def on_event(event):
        if event["event"] == "part" and event["name"] == "led":
            blinks.put(event["shows"])

    with RunningBoard("esp32_publisher", on_event=on_event) as board:
        for _ in range(2):
            blinks.get(timeout=30)
        before = switches(board._process.pid)
        for _ in range(10):  # without an agent, the LED blinks
            blinks.get(timeout=30)
        assert switches(board._process.pid) - before < 150


def switches(pid):
    total = 0
    for thread in os.listdir(f"/proc/{pid}/task"):
        with open(f"/proc/{pid}/task/{thread}/status") as file:
            total += sum(int(line.split()[1]) for line in file if line.startswith("voluntary"))
    return total


def test_a_module_that_the_board_is_said_to_have(program):
    folder = program("import my_driver\n")
    with pytest.raises(StartError, match="--provided my_driver"):
        RunningBoard(folder, BOARD).start()
    with RunningBoard(folder, BOARD, provided=["my_driver"]) as board:
        assert "no module named 'my_driver'" in board.wait_end()
        assert "my_driver.py beside main.py" in board.wait("a virtual board has no module")
    (folder / "my_driver.py").write_text("print('mine')\n")
    with RunningBoard(folder, BOARD, provided=["my_driver"]) as board:
        board.wait("mine")
