"""The options about what boards get: they are rules for all, and the last ones."""

import re

import pytest
from unit.tools.agent.test_command import options, parser, parts

from uros.qos import QoSProfile, ReliabilityPolicy
from uros.tools.agent import command
from uros.tools.agent.options.rules import make_rules
from uros.tools.errors import ToolError


def settings(line, key=1, node="/n"):
    return make_rules(options(line)).settings(key, "10.0.0.1:7", node)


def test_rules_of_the_command_line_apply_to_all_clients():
    got = settings(
        "udp4 --namespace hall --remap a:=/b --remap /c:=d --max-rate 2.5 tcp4 --max-size 100"
        " --qos /odom:reliability=best_effort,depth=1 --qos o*:depth=2"
    )
    assert [got.topic(f"rt/{name}") for name in "ace"] == ["rt/b", "rt/d", "rt/hall/e"]
    assert (got.max_rate, got.max_size) == (2.5, 100)
    qos = QoSProfile(9)
    got.apply(qos, "rt/odom")
    assert (qos.depth, qos.reliability) == (2, ReliabilityPolicy.BEST_EFFORT)


def test_the_command_line_overrides_the_file(tmp_path):
    one, two = tmp_path / "one.toml", tmp_path / "two.toml"
    one.write_text("[[client]]\nnamespace = 'one'\nmax_size = 1\nmax_rate = 1\n")
    two.write_text("[[client]]\nkey = 1\nnamespace = 'two'\nmax_size = 2\n")
    files = f"--control {one} --control {two}"
    got = settings(f"udp4 --max-size 3 {files}")
    assert (got.namespace, got.max_size, got.max_rate) == ("/two", 3, 1.0)
    got = settings(f"udp4 {files}", key=2)
    assert (got.namespace, got.max_size) == ("/one", 1)


@pytest.mark.parametrize(
    "line, said",
    [
        ("--remap a", "--remap 'a' is not OLD:=NEW"),
        ("--remap a:=b --remap a:=c", "--remap 'a:=c': a is renamed to b already"),
        ("--remap :=b", "--remap ':=b' is not OLD:=NEW"),
        ("--remap a:=1b", "the command line: remap: '1b' is no ROS name"),
        ("--namespace 1x", "the command line: namespace: '1x' is no ROS name"),
        ("--qos /a", "--qos '/a' is not TOPIC:POLICY=VALUE,..."),
        ("--qos /a:depth", "--qos 'depth' is not TOPIC:POLICY=VALUE,..."),
        ("--qos /a:depth=0", "depth is 0, not a whole number from 1"),
        ("--qos /a:dept=1", "did you mean 'depth'?"),
        ("--control /nowhere.toml", "/nowhere.toml: No such file"),
    ],
)
def test_errors_of_invalid_rules_have_the_remedy(line, said):
    with pytest.raises(ToolError, match=re.escape(said)):
        command.run(parser().parse_args(["udp4", "-p", "0", "-m", "memory", *line.split()]))


@pytest.mark.parametrize(
    "line, said",
    [
        ("--max-rate 0", "'0' is not a number above 0"),
        ("--max-size 1.5", "'1.5' is not an integer above 0"),
        ("--domain 233", "'233' is not a domain; give 0 to 232"),
    ],
)
def test_invalid_numbers_are_rejected(line, said, capsys):
    with pytest.raises(SystemExit):
        parts(f"udp4 {line}")
    assert said in capsys.readouterr().err
