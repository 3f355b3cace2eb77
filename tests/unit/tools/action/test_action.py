import argparse
import json
from types import SimpleNamespace
from unittest.mock import Mock

import pytest

from uros.interfaces import codec, load
from uros.tools import cli
from uros.tools.action import echo
from uros.tools.action import goal as goal_module
from uros.tools.action.goal import Goal

FIBONACCI = "test_msgs/action/Fibonacci"
KIND = load(FIBONACCI)
GOAL = ["send_goal", "/x", FIBONACCI]


@pytest.mark.parametrize(
    "arguments, status, said",
    [
        (["send_goal", "/x", "test_msgs/Fibonaci"], 1, "unknown type 'test_msgs/action/Fibonaci'"),
        (["send_goal", "/x", "std_msgs/msg/String"], 1, "std_msgs/msg/String is not an action"),
        ([*GOAL, "{ordre: 1}"], 1, "has no field 'ordre'; it has order; did you mean 'order'?"),
        ([*GOAL, "order: 1.5"], 1, "Fibonacci_Goal.order takes a whole number from -2147483648"),
        ([*GOAL, "order: 3000000000"], 1, "Fibonacci_Goal.order takes a whole number"),
        ([*GOAL, "[1]"], 1, "Fibonacci_Goal: the values are fields by name, such as {order: ...}"),
        ([*GOAL, "{order: 1"], 1, "the values are not YAML"),
        ([*GOAL, "order: 1", "--stdin"], 1, "give either VALUES or --stdin"),
        ([*GOAL, "-t", "-1"], 2, "'-1' is not a number of 0 or more"),
        ([*GOAL, "-t", "0.1"], 1, "there was no server of the action /x within 0.1 s: no other"),
        (["send_goal", "/x\x1b"], 2, "is not an action name"),
        (["send_goal"], 2, "NAME"),
        (["type", "/x"], 1, "there is no action '/x': no other participant was found in domain"),
        (["type", "/1x"], 2, "'/1x' is not an action name"),
        (["echo", "/x"], 1, "there is no action '/x'"),
        (["echo", "/x", "std_srvs/srv/Trigger"], 1, "std_srvs/srv/Trigger is not an action"),
        (["echo", "/x", "-i", "GOAL"], 2, "'GOAL' is none of GOAL_SERVICE, CANCEL_SERVICE,"),
        (["echo", "/x", "-i", "STATUS"], 2, "did you mean 'STATUS_TOPIC'?"),
        (["echo", "/x", "--interfaces", "nowhere"], 1, "nowhere: no such folder"),
        (["find"], 2, "TYPE"),
        (["sned_goal"], 2, "did you mean 'send_goal'?"),
    ],
)
def test_errors_of_the_command_line(arguments, status, said, capsys, own_domain_id):
    if status == 1:
        arguments = [*arguments, "--domain", str(own_domain_id)]
    assert cli.main(["action", *arguments]) == status
    captured = capsys.readouterr()
    assert said in captured.err
    assert captured.out in ("", "Waiting for an action server to become available...\n")


def test_an_empty_domain(capsys, own_domain_id):
    for verb, said in (("list", ""), ("list -c", "0\n"), ("list --json", "[]\n"),
                       (f"find {FIBONACCI} -c", "0\n")):  # fmt: skip
        assert cli.main(["action", *verb.split(), "--domain", str(own_domain_id)]) == 0
        assert capsys.readouterr().out == said
    assert cli.main(["action", "find", "test_msgs/Fibonaci", "--domain", str(own_domain_id)]) == 0
    assert f"did you mean '{FIBONACCI}'?" in capsys.readouterr().err
    assert cli.main(["action", "info", "/x", "--json", "--domain", str(own_domain_id)]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed == {"name": "/x", "types": [], "clients": [], "servers": []}


@pytest.mark.parametrize(
    "options, chosen, folders",
    [
        ([], ["GOAL_SERVICE", "CANCEL_SERVICE", "RESULT_SERVICE", "FEEDBACK_TOPIC",
              "STATUS_TOPIC"], []),
        (["-i", "status_topic"], ["STATUS_TOPIC"], []),
        (["--action-interfaces", "GOAL_SERVICE|feedback_topic"],
         ["GOAL_SERVICE", "FEEDBACK_TOPIC"], []),
        (["--interfaces", "CANCEL_SERVICE", "--interfaces", "my_msgs"], ["CANCEL_SERVICE"],
         ["my_msgs"]),
    ],
)  # fmt: skip
def test_the_interfaces_that_echo_prints(options, chosen, folders):
    parser = argparse.ArgumentParser()
    echo.add_arguments(parser)
    args = parser.parse_args(["/x", *options])
    assert echo._chosen(args) == chosen and args.interfaces == folders


class LateNetwork:
    """A network on which feedback is received behind the result."""

    def __init__(self):
        self.graph = SimpleNamespace(servers=lambda name: [])
        self.received = None

    def listen(self, topic, type_name, qos, received):
        self.received = received

    def spin(self, done, seconds):
        assert not done() and seconds < 1
        message = KIND.Impl.FeedbackMessage()
        message.goal_id.uuid = self.goal.id
        message.feedback.sequence = [0, 1, 1]
        self.received(SimpleNamespace(cdr=codec.to_cdr(message)))
        return False


def test_feedback_behind_the_result_is_passed_on(monkeypatch):
    """Another thread may receive it than the one that receives the result."""
    monkeypatch.setattr(goal_module, "ServiceClient", lambda *_: Mock())
    monkeypatch.setattr(Goal, "_answer", lambda *_: "the response")
    network, feedback = LateNetwork(), []
    network.goal = Goal(network, "/fibonacci", KIND, feedback.append)
    assert network.goal.result(None) == "the response"
    assert [list(message.sequence) for message in feedback] == [[0, 1, 1]]
    network.spin = None  # without a listener nothing is waited for
    assert Goal(network, "/fibonacci", KIND).result(None) == "the response"
