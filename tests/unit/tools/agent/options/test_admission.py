"""Options of ``uros agent`` about who may come in and who is forgotten."""

import re

import pytest
from support.client import XrceClient
from support.lines import UdpLine
from unit.agent.transports.test_process import agent as process
from unit.tools.agent.test_command import options, parser, parts

from uros.agent.policy.admission import MAX_CLIENTS
from uros.agent.policy.liveliness import DEAD_TIME
from uros.tools.agent import command
from uros.tools.agent.options import rules
from uros.tools.agent.options.admission import make_admission
from uros.tools.errors import ToolError
from uros.wire import ids


def made(line):
    got = options(line)
    return make_admission(got, rules.make_rules(got))


def test_nothing_said_lets_all_in_and_forgets_after_the_agents_time():
    one = made("udp4")
    assert (one.keys, one.networks, one.max_clients) == (frozenset(), (), 4096)
    assert options("udp4").dead_time is None


def test_what_stands_behind_any_transport_adds_up(tmp_path):
    file = tmp_path / "rules.toml"
    file.write_text('[admission]\nkeys = ["0x10"]\nmax_clients = 9\n')
    one = made(
        f"udp4 --allow-key 0x11 --allow-net 10.0.0.0/8 --control {file} tcp4 --allow-key 18"
        " --allow-net fd00::/8 --max-clients 7"
    )
    assert one.keys == {0x10, 0x11, 0x12}
    assert [str(it) for it in one.networks] == ["10.0.0.0/8", "fd00::/8"]
    assert one.max_clients == 7


@pytest.mark.parametrize("text, seconds", [("0", 0.0), ("30", 30.0), ("1.5", 1.5)])
def test_dead_time(text, seconds):
    assert options(f"udp4 --dead-time {text}").dead_time == seconds


@pytest.mark.parametrize("text", ["x", "nan", "inf", "86401", "1e99", "1_0.0.0"])
def test_a_dead_time_that_is_none(text, capsys):
    with pytest.raises(SystemExit):
        parts(f"udp4 --dead-time {text}")
    assert f"{text!r} is not a number of seconds from 0 (never) to 86400" in capsys.readouterr().err


@pytest.mark.parametrize(
    "line, said",
    [
        ("--allow-key x", "the command line: key is 'x', not a whole number from 0 to 4294967295"),
        ("--allow-key 4294967296", "the command line: key is 4294967296"),
        ("--allow-net eth0", "the command line: 'eth0' is no network"),
        ("--max-clients 5000", "the command line: max_clients is 5000, not a whole number"),
    ],
)
def test_mistakes_end_the_agent_and_are_named(line, said):
    with pytest.raises(ToolError, match=re.escape(said)):
        command.run(parser().parse_args(["udp4", "-p", "0", "-m", "memory", *line.split()]))


def test_a_mistake_in_a_file_names_the_file(tmp_path):
    file = tmp_path / "rules.toml"
    file.write_text("[admission]\nmax_clients = 0\n")
    with pytest.raises(ToolError, match=re.escape(f"{file}: [admission]: max_clients is 0")):
        command.run(parser().parse_args(["udp4", "-m", "memory", "--control", str(file)]))


def test_an_agent_started_with_them_holds_to_them():
    line = ("udp4", "-p", 0, "-m", "memory", "--allow-key", "0x11", "--dead-time", "0")
    with process(*line) as one:
        port = int(one.until(r"running\.\.\. +\| port: (\d+)")[1])
        here, other = UdpLine(port), UdpLine(port)
        try:
            assert XrceClient(here, 0x11).open() == ids.STATUS_OK
            assert XrceClient(other, 0x22).open() == ids.STATUS_ERR_DENIED
            one.until(r"client key not allowed +\| client_key: 0x00000022.*--allow-key 0x00000022")
        finally:
            here.close()
            other.close()


def test_the_help_tells_the_defaults():
    (udp,) = [it for it in parser()._actions if it.dest == "transport"]
    said = " ".join(udp.choices["udp4"].format_help().split())
    assert f"(default: {MAX_CLIENTS}, which is also the highest)" in said
    assert f"(default: {DEAD_TIME:.0f}; 0: never)" in said
