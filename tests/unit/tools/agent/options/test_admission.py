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


def test_by_default_all_clients_are_admitted_until_the_default_dead_time():
    one = made("udp4")
    assert (one.keys, one.networks, one.max_clients) == (frozenset(), (), 4096)
    assert options("udp4").dead_time is None


def test_options_of_all_transports_are_combined(tmp_path):
    file = tmp_path / "rules.toml"
    file.write_text('[admission]\nkeys = ["0x10"]\nmax_clients = 9\n')
    one = made(
        f"udp4 --allow-key 0x11 --allow-net 10.0.0.0/8 --control {file} tcp4 --allow-key 18"
        " --allow-net fd00::/8 --max-clients 7"
    )
    assert one.keys == {0x10, 0x11, 0x12}
    assert [str(network) for network in one.networks] == ["10.0.0.0/8", "fd00::/8"]
    assert one.max_clients == 7


@pytest.mark.parametrize("text, seconds", [("0", 0.0), ("30", 30.0), ("1.5", 1.5)])
def test_dead_time(text, seconds):
    assert options(f"udp4 --dead-time {text}").dead_time == seconds


@pytest.mark.parametrize("text", ["x", "nan", "inf", "86401", "1e99", "1_0.0.0"])
def test_invalid_dead_times(text, capsys):
    with pytest.raises(SystemExit):
        parts(f"udp4 --dead-time {text}")
    assert f"{text!r} is not a number of seconds from 0 (never) to 86400" in capsys.readouterr().err


@pytest.mark.parametrize(
    "line, said",
    [
        ("--allow-key x", "the command line: key is 'x', not a whole number from 0 to 4294967295"),
        ("--allow-key 4294967296", "the command line: key is 4294967296"),
        ("--allow-net eth0", "the command line: networks: 'eth0' is no network"),
        ("--max-clients 5000", "the command line: max_clients is 5000, not a whole number"),
    ],
)
def test_invalid_options_end_the_agent_with_their_name(line, said):
    with pytest.raises(ToolError, match=re.escape(said)):
        command.run(parser().parse_args(["udp4", "-p", "0", "-m", "memory", *line.split()]))


def test_a_mistake_in_a_file_names_the_file(tmp_path):
    file = tmp_path / "rules.toml"
    file.write_text("[admission]\nmax_clients = 0\n")
    with pytest.raises(ToolError, match=re.escape(f"{file}: [admission]: max_clients is 0")):
        command.run(parser().parse_args(["udp4", "-m", "memory", "--control", str(file)]))


def test_all_mistakes_of_a_file_are_named(tmp_path):
    file = tmp_path / "rules.toml"
    file.write_text("[[client]]\nkey = 'x'\nmax_rate = 0\n[[client]]\nnamespace = '7'\n")
    with pytest.raises(ToolError) as raised:
        command.run(parser().parse_args(["udp4", "-m", "memory", "--control", str(file)]))
    first, second, third = str(raised.value).split("; ")
    assert first.startswith(f"{file}: [[client]] number 1: key is 'x'")
    assert second.startswith(f"{file}: [[client]] number 1: max_rate is 0")
    assert third.startswith(f"{file}: [[client]] number 2: namespace: ")


def test_all_mistakes_of_a_command_line_are_named():
    line = "udp4 -m memory --allow-key x --allow-net eth0".split()
    with pytest.raises(ToolError) as raised:
        command.run(parser().parse_args(line))
    first, second = str(raised.value).split("; ")
    assert first.startswith("the command line: key is 'x'")
    assert second.startswith("the command line: networks: 'eth0'")


def test_a_running_agent_applies_the_options():
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


def test_the_help_has_the_defaults():
    (udp,) = [action for action in parser()._actions if action.dest == "transport"]
    said = " ".join(udp.choices["udp4"].format_help().split())
    assert f"(default: {MAX_CLIENTS}, which is also the highest)" in said
    assert f"(default: {DEAD_TIME:.0f}; 0: never)" in said
