"""Tests of pins, PWM, converters, interrupts and an access point, on both engines."""

import textwrap

import pytest
from mpy.harness import INSTALLED

from uros.boards.virtual.engine.runner import RunningBoard

ENGINES = ("cpython", "micropython")
BUTTON = "esp32_button_led"


@pytest.fixture(autouse=True)
def installed(monkeypatch):
    monkeypatch.setenv("UROS_MICROPYTHON", str(INSTALLED))


@pytest.fixture(params=ENGINES)
def start(request, tmp_path):
    """Return a function that starts a program on a board."""
    boards = []

    def run(text, name=BUTTON, **options):
        (tmp_path / "main.py").write_text(textwrap.dedent(text))
        boards.append(RunningBoard(tmp_path, name, request.param, **options))
        boards[-1].start()
        return boards[-1]

    yield run
    for board in boards:
        board.stop()


def test_values_and_errors_of_pins(start):
    board = start(
        """
        from machine import ADC, PWM, Pin
        led = Pin(22, Pin.OUT, value=1)
        pwm = PWM(led, freq=5000, duty_u16=16384)
        print(pwm.freq(), pwm.duty_u16(), pwm.duty(), pwm.duty_ns())
        pwm.duty(1023)
        pwm.duty_ns(100000)
        print(pwm.duty_u16())
        pwm.deinit()
        print(ADC(34).read_u16(), ADC(Pin(34)).read_uv())
        for call in (
            lambda: Pin(99), lambda: ADC(5), lambda: PWM(Pin(22), freq=0, duty_u16=0),
            lambda: pwm.duty_u16(65536),
        ):
            try:
                call()
            except ValueError as error:
                print("ValueError", error)
        print("end")
        """
    )
    board.wait_end()
    lines = list(board.console.queue)
    assert lines[0] == "5000 16384 256 50000" and lines[1] == "32768"
    assert lines[2] == "32768 1650025"
    assert [line.partition(": ")[0] for line in lines[3:]] == [
        "ValueError invalid pin", "ValueError Pin doesn't have ADC capabilities",
        "ValueError freq must be from 1Hz to 40MHz", "ValueError duty must be from 0 to 65535",
        "end",
    ]  # fmt: skip
    assert board.shown("led") == ["off", "on", "25 %", "on", "50 %", "on"]


def test_ticks_and_the_real_time_clock_agree(start):
    """MicroPython's engine computes the ticks itself; the clock is read from the board."""
    board = start(
        """
        import time
        for _ in range(50):
            before = time.time_ns() // 1000
            ticks = time.ticks_us()
            after = time.time_ns() // 1000
            assert before <= ticks <= after, (before, ticks, after)
            assert ticks // 1000 <= time.ticks_ms() <= time.time_ns() // 1000000
        print("agree")
        """,
    )
    board.wait("agree")


EDGES = """
    import time
    from machine import Pin
    edges = []
    def on_edge(pin):
        edges.append((time.ticks_us(), pin.value()))
    button = Pin(23, Pin.IN, Pin.PULL_UP)
    button.irq(on_edge, Pin.IRQ_FALLING | Pin.IRQ_RISING)
    print("ready")
    while not edges:
        time.sleep_ms(50)
    time.sleep_ms(700)
    button.irq(None)
    print([after[0] - before[0] for before, after in zip(edges, edges[1:])])
    print([level for _, level in edges])
    """


def test_interrupts_have_the_time_and_the_level_of_the_edge(start):
    """A handler gets the time and level of its edge, although it runs later.

    Edges of a bounce are some hundred microseconds apart.
    """
    board = start(EDGES, seed=5)
    board.wait("ready")
    board.happen("button:tap=0.5")
    gaps = eval(board.wait("["))
    levels = eval(board.wait("["))
    assert len(levels) == len(gaps) + 1 >= 6
    assert levels == [0, 1] * (len(levels) // 2)  # levels alternate
    assert sum(gaps) == pytest.approx(508_000, abs=9_000)
    assert max(gaps) > 480_000 and sum(sorted(gaps)[:-1]) < 17_000
    assert board.shown("button") == ["released", "pressed", "released"]


def test_a_handler_that_raises_ends_the_program_as_it_would_on_a_board(start):
    board = start(
        """
        import time
        from machine import Pin
        def on_edge(pin):
            raise ValueError("too many")
        Pin(23, Pin.IN, Pin.PULL_UP).irq(on_edge, Pin.IRQ_FALLING)
        print("ready")
        while True:
            time.sleep_ms(10)
        """
    )
    board.wait("ready")
    board.happen("button:press")
    assert "ValueError: too many" in board.wait_end()


def test_time_that_goes_faster(start):
    board = start(
        """
        import time
        print("begin")
        time.sleep(20)
        print("end")
        """,
        speed=100.0,
    )
    board.wait("begin")
    board.wait("end", 10)


ACCESS_POINT = """
    import network, socket, time
    from uros.transport.wlan import AccessPoint
    point = AccessPoint("ESP32-Access-Point", "123456789", address="10.16.1.1")
    while True:
        try:
            point.check()
            break
        except OSError as error:
            print("not yet:", error.args[1])
            time.sleep_ms(100)
    print(point.wlan.ifconfig()[0], len(point.wlan.status("stations")))
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.connect(("10.16.1.2", 8888))
    sock.send(b"hello")
    print("sent")
    """


def test_an_access_point_of_the_boards_own(start):
    import socket

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as agent:
        agent.bind(("127.0.0.1", 0))
        agent.settimeout(20)
        board = start(
            ACCESS_POINT, "esp32_wifi_publisher", agent=agent.getsockname(), address="127.0.0.9",
            happen=["wlan:alone"],
        )  # fmt: skip
        assert "nobody has joined the access point ESP32-Access-Point" in board.wait("not yet")
        board.happen("wlan:off")
        assert board.wait("10.16.1.1") == "10.16.1.1 1"
        data, (host, _) = agent.recvfrom(100)
    assert data == b"hello" and host == "127.0.0.9"
    board.wait_shows("wlan", "ESP32-Access-Point, one computer")
