"""firmware/sprturtlebot_pid: a visualiser's lines drive the virtual rover, in virtual time."""

import contextlib
import math
import re

import pytest
from unit.firmware.rover_board import TICKS, rover_board


class Line:
    """The connection; ``coming`` are (µs, octets) from the visualiser, ``sent`` the lines to it."""

    def __init__(self, board):
        self.board = board
        self.connected = False
        self.reason = ""
        self.coming = []
        self.sent = []

    def receive(self, timeout_ms):
        end = self.board.t_us + timeout_ms * 1000
        if self.coming and self.coming[0][0] <= end:
            at, octets = self.coming.pop(0)
            self.board.to(max(at, self.board.t_us))
            self.connected = True
            return octets
        self.board.to(end)
        return b""

    def send(self, text):
        if self.connected:
            self.sent.append(text)
        return self.connected


class Person:
    """The program and the person at its visualiser."""

    def __init__(self, board):
        self.board = board
        self.rover = board.rover
        main = board.main
        main.Station = lambda *_: None
        main.Line = lambda *_: Line(board)
        main.print = self.printed = lambda *words: self.console.append(" ".join(map(str, words)))
        self.console = []
        main.start()
        self.tuner = main.tuner
        self.line = self.tuner.line
        self.line.connected = True
        self.main = main
        self.run(0.1)

    def run(self, seconds):
        end = self.board.t_us + round(seconds * 1e6)
        while self.board.t_us < end:
            self.main.step()

    def send(self, *parts, apart=0.0):
        at = self.board.t_us
        for part in parts:
            self.line.coming.append((at, part))
            at += round(apart * 1e6)

    def samples(self):
        return [
            [int(field) for field in line.split(",")]
            for line in self.line.sent
            if not line.startswith("#")
        ]

    def remarks(self):
        return [line for line in self.line.sent if line.startswith("#")]


@contextlib.contextmanager
def person_at(**options):
    with rover_board("sprturtlebot_pid", "config", "main", **options) as board:
        yield Person(board)


@pytest.fixture
def person():
    with person_at() as running:
        yield running


def test_samples_of_torques_speeds_and_targets_are_sent_every_60_ms(person):
    person.send(b"200,30,5,210,31,6,0.3,0\n")
    person.run(1.5)
    assert len(person.samples()) == pytest.approx(1.6 / 0.06, abs=2)
    torque_r, torque_l, speed_r, speed_l, target_r, target_l = person.samples()[-1]
    assert 60 < torque_r < 120 and 60 < torque_l < 120
    assert speed_r == pytest.approx(300, rel=0.1) and speed_l == pytest.approx(300, rel=0.1)
    assert (target_r, target_l) == (300, 300)
    assert person.rover.v == pytest.approx(0.3, rel=0.1)
    right, left = person.tuner.right_pid, person.tuner.left_pid
    assert (right.kp, right.ki, right.kd) == (200, 30, 5)
    assert (left.kp, left.ki, left.kd) == (210, 31, 6)


def test_new_gains_reset_the_integral(person):
    person.send(b"100,600,0,100,600,0,0.3,0\n")
    person.run(1.5)
    pid = person.tuner.right_pid
    assert pid.integral
    person.tuner.drive((100, 60, 0, 100, 60, 0, 0.3, 0))
    assert person.tuner.chassis.drive.v == 0.3
    assert pid.integral == 0


def test_the_rover_stops_two_seconds_after_a_line(person):
    person.send(b"200,30,5,200,30,5,0.3,0\n")
    person.run(1.9)
    assert person.rover.v > 0.25
    person.run(0.6)
    assert person.rover.v == 0
    assert 0.5 < person.rover.path_length < 0.7


@pytest.mark.parametrize(
    ("line", "v", "w"),
    [
        (b"200,30,5,200,30,5,0.3,1", 0.0, 0.3 / 0.134),
        (b"200,30,5,200,30,5,0.3,-1", 0.0, -0.3 / 0.134),
        (b"200,30,5,200,30,5,-0.3,1", 0.0, 0.3 / 0.134),  # rot alone determines the direction
        (b"200,30,5,200,30,5,-0.3,0", -0.3, 0.0),
        (b"200,30,5,200,30,5,5,0", 0.9, 0.0),  # the limit of a wheel
    ],
)
def test_speed_and_rot(person, line, v, w):
    person.send(line)
    person.run(1.2)
    assert person.rover.v == pytest.approx(v, abs=0.05)
    assert person.rover.w == pytest.approx(w, abs=0.2)


def test_a_line_without_an_end_is_complete_after_a_pause(person):
    person.send(b"200,30,5,200,", b"30,5,0.3,0", apart=0.03)
    person.run(0.05)
    assert person.tuner.chassis.drive.v == 0
    person.run(0.06)
    assert person.tuner.chassis.drive.v == 0.3


def test_invalid_lines_are_reported_and_move_nothing(person):
    person.send(b"200,30,5,200,30,5,inf,0\n", b"hello\n", b"200,30,5,-200,30,5,1.0,0\n")
    person.run(0.5)
    assert person.rover.path_length == 0
    remarks = person.remarks()
    assert "speed is inf" in remarks[0] and "8" in remarks[1] and "L_Kp" in remarks[2]


def test_a_line_sent_at_the_start_is_handled():
    with rover_board("sprturtlebot_pid", "config", "main") as board:
        person = Person(board)
        person.line.connected = False
        person.run(0.1)
        assert not person.rover.driver.powered
        person.send(b"200,30,5,200,30,5,0.3,0\n")
        person.run(1.0)
        assert person.rover.driver.powered
        assert person.rover.v == pytest.approx(0.3, rel=0.1)


def test_without_a_connection_the_motors_are_off(person):
    person.send(b"200,30,5,200,30,5,0.3,0\n")
    person.run(0.8)
    person.line.connected = False
    person.line.reason = "the network is gone"
    person.run(0.04)
    assert not person.rover.driver.powered
    assert person.console[-1] == "no visualiser: the network is gone"
    person.run(1.0)
    assert person.rover.v == 0
    # It does not continue without a new line.
    person.line.connected = True
    person.line.reason = ""
    person.run(0.5)
    assert person.rover.v == 0


def test_a_stuck_wheel_is_reported_and_delays_the_next_line(person):
    person.rover.fault("right_stuck")
    person.send(b"600,3000,0,600,3000,0,0.3,0\n")
    person.run(1.2)
    assert "right wheel does not turn" in person.remarks()[0]
    person.send(b"200,30,5,200,30,5,0.3,0\n")
    person.run(0.1)
    assert "not driven" in person.remarks()[-1]


@pytest.mark.parametrize("seed", [0, 3])
def test_tuning_finds_gains_that_drive_well(seed):
    with person_at(seed=seed, begin_us=TICKS - 3_000_000) as person:
        person.send(b"0,0,0,0,0,0,0,0\n")
        person.run(14)
        tuning, right, left = person.remarks()
        assert "tuning" in tuning
        names = {}
        for line in (right, left):
            exec(line.removeprefix("# "), names)  # in the form of config.py
        for name in ("RIGHT_PID", "LEFT_PID"):
            assert names[name].keys() == getattr(person.board.config, name).keys()
            assert 0 < names[name]["kp"] < 1000 and 0 < names[name]["ki"] < 10000
        assert abs(math.hypot(person.rover.x, person.rover.y)) < 0.1  # back again
        pids = (person.tuner.right_pid, person.tuner.left_pid)
        gains = ",".join(f"{gain:.4g}" for pid in pids for gain in (pid.kp, pid.ki, pid.kd))
        person.line.sent.clear()
        person.send(f"{gains},0.3,0\n".encode())
        person.run(1.9)
        speeds = [sample[2:4] for sample in person.samples()]
        assert all(270 < speed < 330 for both in speeds[12:-1] for speed in both), speeds


def test_a_line_during_tuning_ends_the_tuning(person):
    person.send(b"0,0,0,0,0,0,0,0\n")
    person.run(3)
    person.send(b"200,30,5,200,30,5,0,0\n")
    person.run(1)
    assert person.rover.v == 0
    assert len(person.remarks()) == 1


def test_a_failed_tuning_is_reported_and_changes_no_gains(person):
    before = vars(person.tuner.left_pid).copy()
    person.rover.fault("left_encoder_dead")
    person.send(b"0,0,0,0,0,0,0,0\n")
    person.run(6)
    assert re.match("# not tuned: the left wheel does not turn", person.remarks()[-1])
    assert vars(person.tuner.left_pid) == before


def test_without_extended_only_two_numbers_are_sent(person):
    person.board.config.EXTENDED = False
    person.line.sent.clear()
    person.send(b"nonsense\n")
    person.run(0.5)
    assert person.line.sent and set(person.line.sent) == {"0,0"}
    assert "left out" in person.console[-1]
