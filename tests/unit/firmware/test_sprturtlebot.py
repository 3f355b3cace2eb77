"""firmware/sprturtlebot: the sub core drives the virtual rover in virtual time, by mailboxes."""

import _thread
import contextlib
import math
import random
import threading

import pytest
from support.variants import slow_except
from unit.firmware.rover_board import TICKS, rover_board

from uros.control.square import Square

STEP_US = 20_000


class Sub:
    """The sub core on a virtual board; ``turn()`` runs 20 ms, ``notes`` are its reports."""

    def __init__(self, board):
        self.board = board
        self.rover = board.rover
        self.mail = board.mail
        self.config = board.config
        self.inbox = board.mail.Mailbox()
        self.outbox = board.mail.Mailbox()
        self.core = board.sub.SubCore(self.inbox, self.outbox)
        self.notes = []
        self.answer = None

    @property
    def t_us(self):
        return self.board.t_us

    def turn(self):
        self.board.to(self.board.t_us + STEP_US)
        self.core.step()
        number = self.outbox.receive()
        while number:
            if number == self.mail.NOTE:
                self.notes.append(self.outbox.value)
            else:
                assert number == self.mail.ODOMETRY
                self.answer = self.outbox.value
            number = self.outbox.receive()

    def run(self, seconds):
        for _ in range(round(seconds * 1e6 / STEP_US)):
            self.turn()

    def power(self, on):
        self.inbox.send(self.mail.POWER, on)

    def command(self, v, w):
        self.inbox.send(self.mail.COMMAND, (v, w))

    def odometry(self):
        """Request the odometry; return x, y, theta, v, w."""
        self.answer = None
        self.inbox.send(self.mail.ODOMETRY)
        self.turn()
        x, y, qz, qw, v, w, pose, twist = self.answer
        assert math.isclose(qz * qz + qw * qw, 1)
        assert len(pose) == len(twist) == 36
        return x, y, 2 * math.atan2(qz, qw), v, w

    def until_it_stands(self):
        while self.rover.speeds != (0.0, 0.0):
            self.turn()


@contextlib.contextmanager
def sub_core(**options):
    with rover_board("sprturtlebot", "config", "mail", "sub", **options) as board:
        yield Sub(board)


@pytest.fixture
def sub():
    with sub_core() as running:
        yield running


@pytest.mark.parametrize("seed", slow_except([0, 7], 7))
def test_odometry_of_a_square_of_a_metre(seed):
    # The ticks wrap during the drive.
    with sub_core(seed=seed, begin_us=TICKS - 4_000_000) as sub:
        rover = sub.rover
        rover.act("place", "0,-0.5,0")  # west of the boxes
        begin = (rover.x, rover.y, rover.theta)
        sub.power(True)
        square = Square()
        corners = {}
        while square.step(*sub.odometry()[:3]):
            sub.command(square.v, square.w)
            sub.run(0.04)
            corners.setdefault(square.corner, (rover.x, rover.y))
            assert sub.t_us < 60e6
        sub.command(0.0, 0.0)
        sub.turn()
        sub.until_it_stands()
        x, y, theta, _, _ = sub.odometry()
        path = rover.path_length
        assert 3.8 < path < 4.4
        assert math.dist(corners[0], corners[2]) > 1.3
        true_x, true_y = rover.x - begin[0], rover.y - begin[1]
        assert math.hypot(x - true_x, y - true_y) < 0.02 * path
        off = math.degrees(math.remainder(theta - (rover.theta - begin[2]), math.tau))
        assert abs(off) < 3
        assert not sub.notes


def test_nothing_moves_before_the_motors_are_switched_on(sub):
    sub.command(0.3, 0.0)
    sub.run(0.5)
    assert sub.rover.path_length == 0
    assert sub.notes == ["cmd_vel is ignored, the motors are off: see motor_power"]
    # Earlier commands have no effect afterwards.
    sub.power(True)
    sub.run(0.5)
    assert sub.rover.path_length == 0
    sub.command(0.3, 0.0)
    sub.run(0.5)
    assert sub.rover.path_length > 0.05


def test_the_rover_stops_within_a_second_of_the_last_command(sub):
    sub.power(True)
    for _ in range(10):
        sub.command(0.4, 0.0)
        sub.run(0.1)
    assert sub.rover.v == pytest.approx(0.4, rel=0.1)
    last = sub.t_us - 100_000
    driven = sub.t_us
    while sub.core.chassis.drive.v:
        sub.turn()
        driven = sub.t_us
    assert 0.9 < (driven - last) / 1e6 <= 1.0
    sub.until_it_stands()
    assert sub.t_us - driven < 600_000
    # The controllers are reset.
    assert sub.core.chassis.drive.right_pid.integral == 0
    sub.run(0.4)
    assert sub.odometry()[3:] == (0.0, 0.0)


def test_a_too_fast_command_is_scaled_and_reported(sub):
    # The document's example: 1.21 and 0.79 m/s at the wheels.
    sub.power(True)
    sub.command(1.0, 1.57)
    sub.turn()
    drive = sub.core.chassis.drive
    assert drive.v + drive.w * sub.config.D == pytest.approx(sub.config.FASTEST)
    assert drive.w / drive.v == pytest.approx(1.57)
    assert sub.notes == ["1.00 m/s with 1.57 rad/s is too fast: it drives 0.74 with 1.17"]
    sub.run(0.8)
    assert sub.rover.w > 0.5  # counter-clockwise


@pytest.mark.parametrize("v", [math.nan, math.inf, -math.inf])
def test_commands_of_nan_are_ignored_and_reported(sub, v):
    sub.power(True)
    sub.command(v, 0.0)
    sub.run(0.2)
    sub.command(0.1, v)
    sub.run(0.2)
    assert sub.rover.path_length == 0
    assert sub.notes == ["cmd_vel is ignored: it is no number"] * 2


def test_power_off_stops_at_once_and_resets_the_controllers(sub):
    sub.power(True)
    sub.command(0.4, 0.0)
    sub.run(0.8)
    sub.power(True)  # repeated: no effect
    sub.turn()
    assert sub.core.chassis.drive.v == 0.4
    sub.power(False)
    sub.turn()
    assert not sub.rover.driver.powered
    drive = sub.core.chassis.drive
    assert (drive.v, drive.right_duty, drive.right_pid.integral) == (0.0, 0.0, 0.0)
    sub.power(True)
    sub.run(0.5)
    sub.until_it_stands()
    assert sub.rover.driver.powered


def test_a_stuck_wheel_stops_both_and_is_reported_once(sub):
    sub.power(True)
    sub.rover.fault("left_stuck")
    for _ in range(30):
        sub.command(0.3, 0.0)
        sub.run(0.1)
    reports = [note for note in sub.notes if "left wheel does not turn" in note]
    assert len(reports) == 1
    assert sub.rover.theta < math.tau  # the rover does not spin about the stuck wheel
    sub.rover.heal()
    sub.run(1.0)
    for _ in range(20):
        sub.command(0.3, 0.0)
        sub.run(0.1)
    assert sub.notes[-1] == "both wheels turn again"
    assert sub.rover.v == pytest.approx(0.3, rel=0.15)


def test_a_nearly_empty_battery_suffices_for_walking_speed(sub):
    sub.power(True)
    sub.rover.act("battery", "12")
    for _ in range(15):
        sub.command(0.3, 0.0)
        sub.run(0.1)
    assert sub.rover.v == pytest.approx(0.3, rel=0.1)


def test_driving_backwards_is_stable(sub):
    sub.power(True)
    for v in (-0.3, 0.3, -0.3):
        for _ in range(15):
            sub.command(v, 0.0)
            sub.run(0.1)
        assert sub.rover.v == pytest.approx(v, rel=0.1)
    sub.until_it_stands()
    x, _, _, _, _ = sub.odometry()
    assert x == pytest.approx(sub.rover.x, abs=0.03)


def test_only_the_newest_mail_of_each_kind_is_handled_in_order(sub):
    box, kinds = sub.mail.Mailbox(), sub.mail
    assert box.receive() == 0
    source = random.Random(1)
    newest = {}
    for at in range(70_000):
        number = source.choice((kinds.POWER, kinds.COMMAND, kinds.ODOMETRY, kinds.NOTE))
        box.send(number, at)
        newest[number] = at
    messages = []
    while number := box.receive():
        messages.append((number, box.value))
    assert messages == sorted(newest.items())


def test_a_withdrawn_command_is_not_reported_as_ignored(sub):
    """The main core replaces a queued command by None when it switches the power."""
    sub.power(False)
    sub.command(0.3, 0.0)
    sub.inbox.send(sub.mail.COMMAND, None)
    sub.run(0.1)
    assert sub.notes == [] and sub.rover.path_length == 0


def test_the_sub_core_runs_in_a_thread_and_stops_the_wheels(monkeypatch):
    """Only its thread calls the sub core; the main core sends two messages."""
    monkeypatch.setattr(_thread, "stack_size", lambda size: None)
    begin, over = threading.Event(), threading.Event()
    with rover_board("sprturtlebot", "config", "mail", "sub", "cores") as board:

        def sleep_ms(ms):
            begin.wait(30)
            board.to(board.t_us + 1000 * ms)
            if board.t_us > 4e6:
                over.set()
                raise SystemExit

        board.sub.time.sleep_ms = sleep_ms
        to_sub, from_sub = board.cores.start_sub_core()
        assert board.cores.start_sub_core() == (to_sub, from_sub)  # idempotent
        to_sub.send(board.mail.POWER, True)
        to_sub.send(board.mail.COMMAND, (0.25, 0.0))
        begin.set()
        assert over.wait(30)
        assert 0.15 < board.rover.path_length < 0.3 and board.rover.speeds == (0.0, 0.0)


def test_an_exception_in_the_sub_core_switches_the_motors_off():
    with rover_board("sprturtlebot", "config", "mail", "sub") as board:
        board.sub.time.sleep_ms = lambda ms: board.to(board.t_us + 1000 * ms)
        inbox = board.mail.Mailbox()
        board.sub.start(inbox, board.mail.Mailbox())
        inbox.send(board.mail.POWER, True)
        inbox.send(board.mail.COMMAND, (0.25, 0.0))
        for _ in range(10):
            board.sub.step()
        assert board.rover.driver.powered and board.rover.v > 0
        inbox.send(board.mail.COMMAND, (None, None))
        with pytest.raises(TypeError):
            board.sub.step()
        assert not board.rover.driver.powered
