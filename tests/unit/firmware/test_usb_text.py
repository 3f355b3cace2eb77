"""firmware/ra6m5_usb_text: a line every second, whatever faults sensors and cable have."""

import re

import pytest
from unit.firmware.loader import load

from uros.boards.virtual.devices.vcnl4010 import proximity_counts
from uros.boards.virtual.world.room import DOOR_CLOSED_MM, DOOR_OPEN_MM

LINE = re.compile(
    r"Room: (-?\d+\.\d)C\|(-?\d+\.\d)F \| Hot: (-?\d+\.\d)C\|(-?\d+\.\d)F \| "
    r"Cold: (-?\d+\.\d)C\|(-?\d+\.\d)F \| Hum: (\d+)% \| Door: (Opened|Closed) \| Lux: (\d+)\r\n"
)


class Running:
    def __init__(self, program):
        self.program = program
        self.main = program.main
        self.printed = []
        self.main.print = lambda *words: self.printed.append(" ".join(map(str, words)))
        self.main.start()
        self.port = self.main.program.port
        # A UART is the port itself; a CDC interface contains it.
        self.line = getattr(self.port, "port", self.port)
        self.arrived = []  # (µs, text of one write)
        write = self.line.write

        def note(data):
            before = len(self.line.written)
            taken = write(data)
            if taken:
                text = bytes(self.line.written[before:]).decode()
                self.arrived.append((program.clock.ticks_us(), text))
            return taken

        self.line.write = note

    def run(self, seconds):
        """Run for ``seconds`` of the board's time; return the texts written."""
        first = len(self.arrived)
        end = self.program.clock.ticks_us() + int(seconds * 1e6)
        while self.program.clock.ticks_us() < end:
            self.main.step()
        return [text for _, text in self.arrived[first:]]

    def happen(self, spec):
        self.program.board.happen(spec)


@pytest.fixture
def board():
    with load("ra6m5_usb_text") as program:
        yield Running(program)


def test_the_line(board):
    lines = board.run(5.1)
    assert len(lines) == 5
    room = board.program.board.room
    t = board.program.clock.world_us() / 1e6
    values = LINE.fullmatch(lines[-1]).groups()
    assert float(values[0]) == pytest.approx(room.temperature(t), abs=0.2)
    assert float(values[2]) == pytest.approx(room.hot(t), abs=2)
    assert float(values[4]) == pytest.approx(room.cold(t), abs=0.3)
    for celsius, fahrenheit in (values[0:2], values[2:4], values[4:6]):
        assert float(fahrenheit) == pytest.approx(float(celsius) * 1.8 + 32, abs=0.15)
    assert int(values[6]) == pytest.approx(room.humidity(t) * 100, abs=2)
    assert values[7] == "Closed"
    assert int(values[8]) == pytest.approx(room.daylight(t), rel=0.05)


def test_the_exact_fields_of_a_line(board):
    program = board.main.program
    program.sht3x.read = lambda: None
    program.sht3x.temperature, program.sht3x.humidity = 23.4, 0.449
    program.mcp9600.read_hot = lambda: 24.0625
    program.mcp9600.read_cold = lambda: -0.5
    program.vcnl4010.read = lambda: True
    program.vcnl4010.proximity, program.vcnl4010.ambient = 2110, 1248
    assert board.run(1.1) == [
        "Room: 23.4C|74.1F | Hot: 24.1C|75.3F | Cold: -0.5C|31.1F"
        " | Hum: 45% | Door: Opened | Lux: 312\r\n"
    ]


def test_lines_are_sent_every_second_to_the_millisecond(board):
    board.run(120.5)
    times = [at for at, _ in board.arrived]
    assert len(times) == 120
    assert all(abs(at - times[0] - n * 1_000_000) < 1000 for n, at in enumerate(times))
    assert board.main.program.missed == 0


def test_lines_are_sent_while_every_transfer_times_out(board):
    board.run(2.1)
    board.happen("bus:stuck")
    board.run(10)
    times = [at for at, _ in board.arrived]
    assert all(abs(at - times[0] - n * 1_000_000) < 1000 for n, at in enumerate(times))
    board.happen("bus:off")
    board.run(2)
    assert LINE.fullmatch(board.run(1)[0])


def test_usb_is_served_all_the_time(board):
    """No step waits longer than 50 ms besides its transfers, and each one reads the port."""
    for _ in range(300):
        board.line.incoming += b"typed by somebody"
        before = board.program.clock.ticks_us()
        board.main.step()
        assert not board.line.incoming
        assert board.program.clock.ticks_us() - before <= 60_000


UNKNOWN = {
    "sht3x": ("Room: -- |", "Hum: -- |"),
    "mcp9600": ("Hot: -- |", "Cold: -- |"),
    "vcnl4010": ("Door: -- |", "Lux: --\r\n"),
}


@pytest.mark.parametrize("kind", ["nack", "absent", "stuck", "stretch"])
@pytest.mark.parametrize("name", UNKNOWN)
def test_a_failing_sensor_leaves_its_fields_empty(board, name, kind):
    board.run(2.1)
    board.happen(f"{name}:{kind}")
    lines = board.run(3)
    assert len(lines) == 3
    for line in lines:
        for field in UNKNOWN[name]:
            assert field in line
        assert line.count("--") == 2
    assert len(board.printed) == 1
    assert board.printed[0].lower().startswith(name + " read failed: ")
    board.happen(name + ":off")
    assert LINE.fullmatch(board.run(2)[-1])
    assert board.printed[1].lower() == name + " read again"
    assert board.main.program.failing == {}


def test_missing_at_start(board):
    for name in UNKNOWN:
        board.happen(name + ":absent")
    assert board.run(2.1)[-1] == "Room: -- | Hot: -- | Cold: -- | Hum: -- | Door: -- | Lux: --\r\n"
    board.happen("all:off")
    assert LINE.fullmatch(board.run(2)[-1])


def test_wrong_crc(board):
    board.happen("sht3x:crc")
    assert board.run(1.1)[0].startswith("Room: -- | Hot: ")
    assert board.printed == ["SHT3x read failed: wrong CRC of the temperature"]


def test_an_endless_measurement_leaves_its_fields_empty(board):
    board.main.program.vcnl4010.read = lambda: False
    assert board.run(1.1)[0].endswith("Door: -- | Lux: --\r\n")
    assert board.printed == ["VCNL4010 read failed: the measurement does not end"]


# The door.


def test_door_states_in_the_virtual_room(board):
    """In ten minutes somebody passes through the door ten times."""
    room = board.program.board.room
    states = set()
    for _ in range(600):
        for line in board.run(1):
            t = board.arrived[-1][0] / 1e6
            if room.door(t - 0.6) == room.door(t):
                door = LINE.fullmatch(line).group(8)
                assert door == ("Closed" if room.door(t) == 0 else "Opened")
                states.add(door)
    assert states == {"Closed", "Opened"}


def test_the_thresholds_are_far_from_both(board):
    closed, opened = proximity_counts(DOOR_CLOSED_MM, 200), proximity_counts(DOOR_OPEN_MM, 200)
    assert opened * 2 < board.main.OPENED_BELOW < board.main.CLOSED_FROM < closed / 2


@pytest.mark.parametrize(
    ("counts", "doors"),
    [
        ([2110, 29_999, 30_000, 20_000, 19_999, 29_999], "OOCCOO"),
        ([25_000, 65_535, 25_000, 2110, 25_000], "OCCOO"),
    ],
)
def test_hysteresis(board, counts, doors):
    program = board.main.program
    program.vcnl4010.read = lambda: True
    letters = ""
    board.run(0.1)
    for count in counts:
        program.vcnl4010.proximity = count
        (line,) = board.run(1)
        letters += LINE.fullmatch(line).group(8)[0]
    assert letters == doors


# The cable.


def test_no_host(board):
    board.run(1.1)
    board.port.opened = False
    assert board.run(3) == []
    board.port.opened = True
    board.run(0.05)
    lines = board.run(2)
    assert len(lines) == 2 and all(LINE.fullmatch(line) for line in lines)


def test_lines_that_the_host_does_not_read_are_dropped(board):
    board.line.room = 0
    assert board.run(3.1) == []
    assert board.main.program.skipped == 3
    board.line.room = 1000
    assert board.run(0.7) == []  # a line is not sent late
    (line,) = board.run(0.3)
    assert LINE.fullmatch(line)
    assert board.arrived[0][0] % 1_000_000 < 1000


def test_a_line_sent_in_pieces_is_complete(board):
    board.line.room = 10
    pieces = board.run(3.9)
    lines = "".join(pieces).splitlines(keepends=True)
    assert len(pieces) > 20
    assert len(lines) == 3 and all(LINE.fullmatch(line) for line in lines)


def test_a_partly_sent_line_is_completed_before_the_next(board):
    board.line.room = 30
    board.run(1.0005)
    board.line.room = 0
    board.run(1.2)
    assert board.main.program.skipped == 1
    board.line.room = 1000
    board.run(1)
    text = board.line.written.decode()
    assert all(LINE.fullmatch(line) for line in text.splitlines(keepends=True))
    assert text.count("\r\n") == 2


def test_a_partly_sent_line_is_dropped_when_the_cable_is_pulled(board):
    board.line.room = 30
    board.run(1.0005)
    board.port.opened = False
    board.run(0.2)
    board.port.opened = True
    del board.line.written[:]
    board.line.room = 1000
    board.run(1)
    assert LINE.fullmatch(board.line.written.decode())


def test_lines_are_sent_over_a_uart_without_usb():
    with load("ra6m5_usb_text", usb=False) as program:
        board = Running(program)
        lines = board.run(3.1)
        assert len(lines) == 3 and all(LINE.fullmatch(line) for line in lines)


# The rest.


def test_the_period_is_kept_after_a_long_wait(board):
    """As after transfers that take a second to fail."""
    board.run(1.1)
    board.program.clock.advance(3_500_000)
    assert "--" in board.run(0.1)[0]  # late, without time to measure
    assert board.main.program.missed == 2
    assert LINE.fullmatch(board.run(0.4)[0])
    times = [at for at, _ in board.arrived]
    assert times[-1] % 1_000_000 < 1000


def test_ticks_that_wrap():
    with load("ra6m5_usb_text", offset_ms=(1 << 30) - 2500) as program:
        board = Running(program)
        assert len(board.run(6.1)) == 6
        assert all(at % 1_000_000 < 1000 for at, _ in board.arrived)


def test_a_failed_start_is_retried():
    with load("ra6m5_usb_text") as program:
        real = program.main.Bus

        def fails(*_):
            raise ValueError("I2C(2) doesn't exist")

        program.main.Bus = fails
        printed = []
        program.main.print = printed.append
        program.main.start()
        assert printed == ["ValueError I2C(2) doesn't exist"]
        program.main.step()
        program.main.Bus = real
        for _ in range(25):
            program.main.step()
        assert program.main.program is not None
        assert len(printed) == 1
