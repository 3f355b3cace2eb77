"""The options about diagnostics; those about the status socket are in test_status.py."""

import pytest
from unit.agent.transports.test_process import agent as process
from unit.tools.agent.test_command import options, parser

from uros.agent.agent import Agent
from uros.agent.log import Log
from uros.agent.observability.diagnostics import NODE, PERIOD, Diagnostics
from uros.agent.server import Server
from uros.middleware.memory import MemoryMiddleware
from uros.tools.agent.options import status_socket


def attached(line, domain=None):
    """Return the diagnostics that the options of a command line attach to a server."""
    middleware = MemoryMiddleware()
    agent = Agent(middleware, Log(0), domain_of_agent=7, domain_override=domain)
    server = Server(agent, [])
    status_socket.attach(options(f"udp4 --no-inspection {line}"), server)
    middleware.close()
    return server.attachments


def test_without_the_option_there_are_none():
    assert attached("--diagnostics-node arm") == []


@pytest.mark.parametrize(
    ("line", "domain", "wanted"),
    [
        ("--diagnostics", None, (7, 1.0, "uros_agent")),
        ("--diagnostics 0.5 --diagnostics-node arm_agent", 3, (3, 0.5, "arm_agent")),
        ("--diagnostics=10 tcp4", 0, (0, 10.0, "uros_agent")),
    ],
)
def test_period_node_and_domain(line, domain, wanted):
    (diagnostics,) = attached(line, domain)
    assert isinstance(diagnostics, Diagnostics)
    assert (diagnostics._domain, diagnostics._period, diagnostics._name) == wanted


def test_the_help_has_the_defaults(capsys):
    with pytest.raises(SystemExit):
        parser().parse_args(["udp4", "--help"])
    said = " ".join(capsys.readouterr().out.split())
    assert f"at this period (default: {PERIOD:g})" in said
    assert f"network (default: {NODE})" in said


@pytest.mark.parametrize(
    ("option", "said"),
    [
        ("--diagnostics=0", "is not a number above 0"),
        ("--diagnostics=x", "is not a number above 0"),
        ("--diagnostics=0.01", "0.01 is not a period from 0.1 to 3600 seconds"),
        ("--diagnostics=3601", "3601 is not a period from 0.1 to 3600 seconds"),
        ("--diagnostics-node=", "'' is not a node's name, such as uros_agent_arm"),
        ("--diagnostics-node=a/b", "'a/b' is not a node's name"),
        ("--diagnostics-node=a b", "'a b' is not a node's name"),
    ],
)
def test_wrong_values_are_named(option, said, capsys):
    with pytest.raises(SystemExit):
        parser().parse_args(["udp4", option])
    assert said in capsys.readouterr().err


def test_an_agent_says_where_it_publishes():
    with process(
        "udp4", "-p", 0, "-m", "memory", "--domain", 5, "--diagnostics"
    ) as one:  # fmt: skip
        one.until(r"publishing +\| topic: /diagnostics, domain_id: 5, node: /uros_agent")
        assert one.end() == 0
