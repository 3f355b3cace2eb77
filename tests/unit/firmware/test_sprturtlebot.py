"""firmware/sprturtlebot: its sub core drives the virtual rover, in virtual time and by nothing but
the mailboxes."""

import _thread
import contextlib
import math
import random
import threading

import pytest
from unit.firmware.rover_board import TICKS, rover_board

from uros.control.square import Square

STEP_US = 20_000


class Sub:
    """The sub core on a virtual board. ``turn()`` is 20 ms, ``notes`` what it said."""

    def __init__(self, it):
        self.it = it
        self.rover = it.rover
        self.mail = it.mail
        self.config = it.config
        self.inbox = it.mail.Mailbox()
        self.outbox = it.mail.Mailbox()
        self.core = it.sub.SubCore(self.inbox, self.outbox)
        self.notes = []
        self.answer = None

    @property
    def t_us(self):
        return self.it.t_us

    def turn(self):
        self.it.to(self.it.t_us + STEP_US)
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
        """x, y, theta, v, w of the answer to a question."""
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
    with rover_board("sprturtlebot", "config", "mail", "sub", **options) as it:
        yield Sub(it)


@pytest.fixture
def sub():
    with sub_core() as running:
        yield running


@pytest.mark.parametrize("seed", [0, 7])
def test_it_drives_a_square_of_a_metre_and_knows_where_it_is(seed):
    # Its ticks wrap on the way.
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
    # What was said before does not count afterwards.
    sub.power(True)
    sub.run(0.5)
    assert sub.rover.path_length == 0
    sub.command(0.3, 0.0)
    sub.run(0.5)
    assert sub.rover.path_length > 0.05


def test_it_stops_within_a_second_of_the_last_command(sub):
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
    # Nothing is left of it: the next command begins from nothing.
    assert sub.core.chassis.drive.right_pid.integral == 0
    sub.run(0.4)
    assert sub.odometry()[3:] == (0.0, 0.0)


def test_a_metre_a_second_on_a_curve_becomes_slower_on_the_same_curve(sub):
    # The document's own example, 1.21 and 0.79 m/s at the wheels.
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
def test_what_is_no_number_is_left_out_and_told(sub, v):
    sub.power(True)
    sub.command(v, 0.0)
    sub.run(0.2)
    sub.command(0.1, v)
    sub.run(0.2)
    assert sub.rover.path_length == 0
    assert sub.notes == ["cmd_vel is ignored: it is no number"] * 2


def test_power_off_stops_at_once_and_on_again_begins_from_nothing(sub):
    sub.power(True)
    sub.command(0.4, 0.0)
    sub.run(0.8)
    sub.power(True)  # said again: nothing changes
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


def test_a_stuck_wheel_stops_both_and_is_told_once(sub):
    sub.power(True)
    sub.rover.fault("left_stuck")
    for _ in range(30):
        sub.command(0.3, 0.0)
        sub.run(0.1)
    told = [it for it in sub.notes if "left wheel does not turn" in it]
    assert len(told) == 1
    assert sub.rover.theta < math.tau  # it does not spin on the other one
    sub.rover.heal()
    sub.run(1.0)
    for _ in range(20):
        sub.command(0.3, 0.0)
        sub.run(0.1)
    assert sub.notes[-1] == "both wheels turn again"
    assert sub.rover.v == pytest.approx(0.3, rel=0.15)


def test_an_empty_battery_makes_it_no_slower_at_a_walk(sub):
    sub.power(True)
    sub.rover.act("battery", "12")
    for _ in range(15):
        sub.command(0.3, 0.0)
        sub.run(0.1)
    assert sub.rover.v == pytest.approx(0.3, rel=0.1)


def test_backwards_it_does_not_run_away(sub):
    sub.power(True)
    for v in (-0.3, 0.3, -0.3):
        for _ in range(15):
            sub.command(v, 0.0)
            sub.run(0.1)
        assert sub.rover.v == pytest.approx(v, rel=0.1)
    sub.until_it_stands()
    x, _, _, _, _ = sub.odometry()
    assert x == pytest.approx(sub.rover.x, abs=0.03)


def test_of_a_flood_of_mail_the_newest_of_each_kind_counts_in_the_order_of_the_kinds(sub):
    box, kinds = sub.mail.Mailbox(), sub.mail
    assert box.receive() == 0
    source = random.Random(1)
    newest = {}
    for at in range(70_000):
        number = source.choice((kinds.POWER, kinds.COMMAND, kinds.ODOMETRY, kinds.NOTE))
        box.send(number, at)
        newest[number] = at
    found = []
    while number := box.receive():
        found.append((number, box.value))
    assert found == sorted(newest.items())


def test_a_command_that_does_not_count_any_more_is_not_told_as_ignored(sub):
    """The main core leaves it in place of one that waits, when it switches the power."""
    sub.power(False)
    sub.command(0.3, 0.0)
    sub.inbox.send(sub.mail.COMMAND, None)
    sub.run(0.1)
    assert sub.notes == [] and sub.rover.path_length == 0


def test_where_there_are_threads_it_runs_in_one_and_stops_the_wheels_by_itself(monkeypatch):
    """Nobody calls it but its thread; the main core sends two messages and does nothing more."""
    monkeypatch.setattr(_thread, "stack_size", lambda size: None)
    begin, over = threading.Event(), threading.Event()
    with rover_board("sprturtlebot", "config", "mail", "sub", "cores") as it:

        def sleep_ms(ms):
            begin.wait(30)
            it.to(it.t_us + 1000 * ms)
            if it.t_us > 4e6:
                over.set()
                raise SystemExit

        it.sub.time.sleep_ms = sleep_ms
        to_sub, from_sub = it.cores.start_sub_core()
        assert it.cores.start_sub_core() == (to_sub, from_sub)  # once, however often it is tried
        to_sub.send(it.mail.POWER, True)
        to_sub.send(it.mail.COMMAND, (0.25, 0.0))
        begin.set()
        assert over.wait(30)
        assert 0.15 < it.rover.path_length < 0.3 and it.rover.speeds == (0.0, 0.0)


def test_what_goes_wrong_there_switches_the_motors_off():
    with rover_board("sprturtlebot", "config", "mail", "sub") as it:
        it.sub.time.sleep_ms = lambda ms: it.to(it.t_us + 1000 * ms)
        inbox = it.mail.Mailbox()
        it.sub.start(inbox, it.mail.Mailbox())
        inbox.send(it.mail.POWER, True)
        inbox.send(it.mail.COMMAND, (0.25, 0.0))
        for _ in range(10):
            it.sub.step()
        assert it.rover.driver.powered and it.rover.v > 0
        inbox.send(it.mail.COMMAND, (None, None))
        with pytest.raises(TypeError):
            it.sub.step()
        assert not it.rover.driver.powered
