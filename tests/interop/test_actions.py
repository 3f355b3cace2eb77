"""Actions of boards on both Pythons, with real rclpy's action client and server.

The agent is a process whose Python has no rclpy.
"""

import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest
from conftest import ROOT
from support.middleware import WITH_SERVICES
from support.peer import RosPeer
from support.variants import slow_except

from uros.boards.virtual.engine.runner import RunningBoard
from uros.interfaces import load as load_type
from uros.interfaces.codec import from_cdr, to_cdr

pytestmark = pytest.mark.timeout(180)

String = load_type("std_msgs/msg/String")
HARDWARE = "ra6m5_sensor_node"
UNKNOWN, EXECUTING, SUCCEEDED, CANCELED, ABORTED = 0, 2, 4, 5, 6
# Orders that tests/firmware/actions and action_peer.py treat specially.
ABORTING, STUBBORN, FAILING = 3, 13, 14


def fibonacci(order):
    sequence = [0, 1]
    while len(sequence) <= order:
        sequence.append((sequence[-1] + sequence[-2]) % 1000000007)
    return sequence


def feedback(order):
    return [fibonacci(n) for n in range(2, order + 1)]


def is_run(received, sent):
    """Whether ``received`` is one run of ``sent``, without a gap; possibly empty.

    The first feedback is lost if the client has not discovered its writer yet, and the last if the
    result comes before it: they have no order, and rclpy drops the feedback of an ended goal.
    """
    last = len(sent) - len(received)
    return any(sent[at : at + len(received)] == received for at in range(last + 1))


@pytest.fixture(scope="module")
def peer(ros_python, domain):
    script = Path(__file__).with_name("action_peer.py")
    with RosPeer(ros_python, domain, script) as running:
        yield running


class ActionBoard:
    """A board, and ``uros agent`` on its serial line."""

    def __init__(self, engine, folder, domain, middleware=WITH_SERVICES):
        self.name = engine
        self.action = f"/{engine}/fibonacci"
        self.peer_action = f"/real/{engine}"  # the action that the board's client uses
        program = folder / engine
        shutil.copytree(ROOT / "tests/firmware/actions", program)
        (program / "config.py").write_text(f"NAME = {engine!r}\nPEER = {self.peer_action!r}\n")
        self.running = RunningBoard(
            program, board=HARDWARE, engine=engine, link=folder / f"tty_{engine}",
            form="mpy" if engine == "micropython" else "py",
        )  # fmt: skip
        self._command = [
            sys.executable, "-m", "uros", "agent", "serial", "-m", middleware, "--domain",
            str(domain), "--stop-at-eof",
        ]  # fmt: skip
        self._log = folder / "agent.log"
        self.agent = None

    def start_agent(self):
        with self._log.open("a") as log:
            self.agent = subprocess.Popen(
                [*self._command, "-D", str(self.running.path)],
                stdin=subprocess.PIPE, stdout=log, stderr=subprocess.STDOUT,
                env=dict(os.environ, PYTHONPATH=str(ROOT / "src")),
            )  # fmt: skip

    def end_agent(self, kill=False):
        if kill:
            self.agent.kill()
        self.agent.communicate(timeout=30)
        log = self._log.read_text()
        assert kill or self.agent.returncode == 0, log
        assert "internal error" not in log, log


@pytest.fixture(scope="module", params=slow_except(["cpython", "micropython"], "micropython"))
def board(request, tmp_path_factory, domain):
    board = ActionBoard(request.param, tmp_path_factory.mktemp("actions"), domain)
    with board.running:
        board.start_agent()
        try:
            yield board
        finally:
            board.end_agent()


# --- a real client, and the board's server --------------------------------------------


def test_a_real_client_uses_a_boards_action(board, peer):
    """Six goals at the same time: accepted, rejected, aborted, canceled, not canceled, failing."""
    orders = {
        "short": [5, 0], "refused": [-1, 0], "aborted": [ABORTING, 0], "canceled": [40, 4],
        "stubborn": [STUBBORN, 4], "failing": [FAILING, 0],
    }  # fmt: skip
    goals = peer.do("send", name=board.action, goals=orders, seconds=30)["goals"]
    short = goals["short"]
    assert short["accepted"] and is_run(short["feedback"], feedback(5))
    assert short["end"] == [SUCCEEDED, fibonacci(5)]
    assert goals["refused"] == {"accepted": False, "feedback": [], "end": None}
    assert goals["aborted"]["end"] == [ABORTED, fibonacci(ABORTING)]
    canceled = goals["canceled"]
    assert canceled["cancel"] == [0, 1] and canceled["end"][0] == CANCELED
    assert 4 <= len(canceled["end"][1]) < 40
    received = canceled["feedback"]
    assert received and is_run(received, feedback(len(canceled["end"][1]) - 1))
    stubborn = goals["stubborn"]
    assert stubborn["cancel"] == [1, 0] and stubborn["end"] == [SUCCEEDED, fibonacci(STUBBORN)]
    assert goals["failing"]["end"] == [ABORTED, []]
    while "ValueError: order 14" not in board.running.console.get(timeout=10):
        pass


def test_a_late_subscriber_gets_the_last_goal_states(board, peer):
    """A subscription to the status topic that is created after two goals lists both."""
    goals = {"one": [5, 0], "two": [6, 0]}
    peer.do("send", name=board.action, goals=goals)
    assert peer.do("watch", name=board.action, keys=["one", "two"], status=SUCCEEDED)["reached"]


def test_results_are_kept_until_their_timeout(board, peer):
    """A result is given again at first; after the timeout the goal's status is UNKNOWN."""
    peer.do("send", name=board.action, goals={"kept": [4, 0]})
    assert peer.do("result", key="kept", status=SUCCEEDED)["end"] == [SUCCEEDED, fibonacci(4)]
    assert peer.do("result", key="kept", status=UNKNOWN)["end"] == [UNKNOWN, []]


def test_goals_are_canceled_by_time_and_all_at_once(board, peer):
    """A cancel request with a time cancels older goals, one without goal or time cancels all."""
    name = board.action
    for key in ("old", "middle", "young"):
        peer.do("begin", name=name, goals={key: [1000, 0]})
    answer = peer.do("cancel", name=name, key="middle", before="old")
    assert (answer["code"], answer["count"]) == (0, 2)
    assert peer.do("watch", name=name, keys=["old", "middle"], status=CANCELED)["reached"]
    answer = peer.do("cancel", name=name, key="old")
    assert (answer["code"], answer["count"]) == (3, 0)  # the goal has terminated
    answer = peer.do("cancel", name=name)
    assert (answer["code"], answer["count"]) == (0, 1)
    goals = peer.do("end", goals=["old", "middle", "young"])["goals"]
    assert [goals[key]["end"][0] for key in goals] == [CANCELED] * 3


def test_a_goal_continues_when_the_agent_dies(board, peer):
    """The agent is killed while a goal executes: the goal continues, and can be canceled and its
    result requested through the next agent."""
    peer.do("begin", name=board.action, goals={"long": [100000, 0]})
    board.end_agent(kill=True)
    board.start_agent()
    answer = peer.do("cancel", name=board.action, key="long", seconds=40)
    assert (answer["code"], answer["count"]) == (0, 1)
    end = peer.do("result", key="long", status=CANCELED)["end"]
    assert end[0] == CANCELED and end[1][:5] == fibonacci(4)


# --- the board's client, and a real server ---------------------------------------------


class Remote:
    """Makes the board's action client send goals, and receives its reports of them."""

    def __init__(self, board, peer):
        self.peer = peer
        self.heard = []
        self.commands = f"/{board.name}/send"
        self.reports = f"/{board.name}/told"
        peer.do("subscribe", topic=self.reports, type=String._TYPE)

    def send(self, number, order, cancel_at=0):
        cdr = to_cdr(String(f"{number} {order} {cancel_at}")).hex()
        answer = self.peer.do("publish", topic=self.commands, type=String._TYPE, cdr=[cdr])
        assert answer["subscribers"]

    def hears(self, beginning, seconds):
        """Whether a report that begins with this text comes within ``seconds``."""
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            try:
                sample = self.peer.message(self.reports, deadline - time.monotonic())
            except AssertionError:
                return False
            report = from_cdr(String, sample).data
            self.heard.append(report[:40])
            if report.startswith(beginning):
                return True
        return False

    def hear(self, until):
        """Return the reports by goal number, when each goal in ``until`` is refused or has its
        result."""
        heard = {str(number): [] for number in until}
        open_goals = set(heard)
        while open_goals:
            text = from_cdr(String, self.peer.message(self.reports)).data
            number, _, report = text.partition(" ")
            heard.setdefault(number, []).append(report)
            if report.split()[0] in ("refused", "result"):
                open_goals.discard(number)
        return heard


@pytest.fixture(scope="module")
def remote(board, peer):
    return remote_of(board, peer)


def remote_of(board, peer):
    """Return a Remote with a real server, whose feedback the board's client has received once.

    An XRCE client is not told whether a server is matched, and goals that are sent before are lost.
    """
    peer.do("serve", name=board.peer_action)
    remote = Remote(board, peer)
    for number in range(1000, 1020):
        remote.send(number, 4)
        if remote.hears(f"{number} feedback", 3):
            remote.hear([number])
            return remote
    raise AssertionError(f"no feedback: {remote.heard}")


def words(sequence):
    return " ".join(map(str, sequence))


def test_a_board_uses_a_real_nodes_action(remote):
    """Five goals at the same time: accepted, rejected, aborted, canceled, not canceled."""
    for number, order, cancel_at in (
        (1, 5, 0), (2, -1, 0), (3, ABORTING, 0), (4, 40, 4), (5, STUBBORN, 4),
    ):  # fmt: skip
        remote.send(number, order, cancel_at)
    heard = remote.hear([1, 2, 3, 4, 5])
    # Feedback is a topic of its own, and may come before the response that accepts the goal.
    assert "accepted" in heard["1"]
    assert [report for report in heard["1"] if report != "accepted"] == [
        *(f"feedback {words(sequence)}" for sequence in feedback(5)),
        f"result {SUCCEEDED} {words(fibonacci(5))}",
    ]
    assert heard["2"] == ["refused"]
    assert heard["3"][-1] == f"result {ABORTED} {words(fibonacci(ABORTING))}"
    assert "cancel 0 1" in heard["4"]
    assert heard["4"][-1].startswith(f"result {CANCELED} 0 1 1 2")
    assert "cancel 0 0" in heard["5"]  # rclpy's response to a refused cancel request
    assert heard["5"][-1] == f"result {SUCCEEDED} {words(fibonacci(STUBBORN))}"


def test_a_boards_goal_is_lost_when_its_agent_dies(board, peer, remote):
    """The board's client reports the goal as lost; with the next agent it works again."""
    remote.send(7, 1000)
    assert remote.hears("7 accepted", 15)
    board.end_agent(kill=True)
    board.running.wait("7 lost")
    board.start_agent()
    # The server still executes the goal: the client receives its feedback, and can send others.
    assert remote.hears("7 feedback", 40)
    assert any(
        remote.send(number, 2) or remote.hears(f"{number} result {SUCCEEDED}", 3)
        for number in range(8, 20)
    ), remote.heard
    peer.do("stop")
