"""The options that say how much boards may have."""

import pytest
from unit.agent.transports.test_process import agent as process
from unit.agent.transports.test_process import refused
from unit.tools.agent.test_command import options

from uros.agent.policy.limits import Limits
from uros.tools.agent.options import limits


def test_limits_have_defaults():
    assert limits.make_limits(options("udp4")) == Limits()


def test_each_option_sets_its_limit():
    line = "udp4 --max-objects 20 --max-message 100000 tcp4 --max-memory 64"
    assert limits.make_limits(options(line)) == Limits(
        objects=20, message=100_000, memory=64 * 1024 * 1024
    )


@pytest.mark.parametrize(
    "words",
    [
        ("--max-objects", "0"), ("--max-objects", "-1"), ("--max-memory", "lots"),
        ("--max-memory", "1.5"), ("--max-message", "300000000"), ("--max-message", ""),
        ("--max-message", "9" * 5000),
    ],
)  # fmt: skip
def test_invalid_numbers_are_rejected(words):
    status, said = refused("udp4", *words)
    assert status == 2 and words[0] in said


def test_the_help_has_the_defaults():
    from unit.tools.agent.test_command import parser

    for name, default in (
        ("--max-objects", Limits().objects),
        ("--max-message", Limits().message),
        ("--max-memory", Limits().memory // 1024 // 1024),
    ):
        (udp,) = [action for action in parser()._actions if action.dest == "transport"]
        (found,) = [
            action for action in udp.choices["udp4"]._actions if name in action.option_strings
        ]
        assert f"(default: {default})" in found.help


def test_an_agent_with_a_watchdog_ends_normally():
    with process("udp4", "--port", "0", "-m", "memory", "--max-objects", "5") as agent:
        agent.until("running")
        assert agent.end() == 0
