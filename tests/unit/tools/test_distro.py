"""--distro and ROS_DISTRO in the tools: whose definitions count."""

import argparse
from importlib import import_module

import pytest

from uros.interfaces import distro
from uros.middleware.user_data import type_hash
from uros.tools import cli
from uros.tools.agent import command as agent
from uros.tools.common import use_distro

PROGRAM = "from sensor_msgs.msg import Range\nm = Range()\nm.variance = 0.1\n"
RANGE = "sensor_msgs::msg::dds_::Range_"
# They join a domain, and use no definition that differs between distributions.
WITHOUT_DEFINITIONS = {"demo", "doctor.command", "rover.calibrate", "run.command"}


@pytest.fixture(autouse=True)
def clean(monkeypatch):
    """What a tool chooses ends with the test."""
    monkeypatch.setenv("ROS_DISTRO", "")
    yield
    distro.use("")


def test_a_board_is_built_with_the_definitions_of_the_distribution(tmp_path, capsys):
    program = tmp_path / "program"
    program.mkdir()
    (program / "main.py").write_text(PROGRAM)
    command = ["board", "build", str(program), str(tmp_path / "out")]
    assert cli.main([*command, "--distro", "humble"]) == 1
    assert "sensor_msgs/msg/Range has no field variance" in capsys.readouterr().err
    distro.use("")
    assert cli.main([*command, "--distro", "jazzy"]) == 0
    text = (tmp_path / "out" / "sensor_msgs" / "msg.py").read_text()
    assert "variance" in text
    (program / "main.py").write_text(PROGRAM.rpartition("m.variance")[0])
    assert cli.main([*command, "--distro", "humble"]) == 0
    text = (tmp_path / "out" / "sensor_msgs" / "msg.py").read_text()
    assert "variance" not in text and "max_range" in text


@pytest.mark.parametrize("by", ["option", "environment"])
def test_tools_use_the_definitions_of_the_distribution(capsys, monkeypatch, by):
    show = ["interface", "show", "sensor_msgs/msg/Range"]
    assert cli.main(show) == 0
    assert "variance" in capsys.readouterr().out
    if by == "option":
        show += ["--distro", "Humble"]
    else:
        monkeypatch.setenv("ROS_DISTRO", "humble")
    assert cli.main(show) == 0
    assert "variance" not in capsys.readouterr().out


def verbs(group=cli._ROOT):
    for member in group.members.values():
        if isinstance(member, cli.Verb):
            yield member
        else:
            yield from verbs(member)


def test_every_verb_that_joins_a_domain_takes_the_distribution():
    joining = set()
    for verb in verbs():
        parser = argparse.ArgumentParser()
        import_module(f"uros.tools.{verb.module}").add_arguments(parser)
        options = parser.format_help()
        if "--domain" in options:
            joining.add(verb.module)
            assert ("--distro" in options) == (verb.module not in WITHOUT_DEFINITIONS), verb.module
    assert {"topic.echo", "bag.record", "param.get", "action.send_goal"} <= joining
    assert joining > WITHOUT_DEFINITIONS


def test_an_unknown_distribution_is_rejected_with_the_known_ones(capsys, monkeypatch):
    show = ["interface", "show", "sensor_msgs/msg/Range"]
    assert cli.main([*show, "--distro", "zebra"]) == 2
    assert "'zebra'; known are humble, iron, jazzy, kilted" in capsys.readouterr().err
    monkeypatch.setenv("ROS_DISTRO", "zebra")
    assert cli.main(show) == 1
    assert "ROS_DISTRO: no definitions of ROS 2 'zebra'" in capsys.readouterr().err


def test_an_agent_of_humble_announces_no_hashes(monkeypatch):
    assert type_hash(RANGE).startswith(b"typehash=RIHS01_")
    parser = argparse.ArgumentParser()
    agent.add_arguments(parser)
    line = "udp4 -p 8888 --distro humble tcp4 -p 8888".split()
    options = agent._common(agent._parts(parser.parse_args(line)))
    assert options.distro == "humble"
    use_distro(options.distro)
    assert type_hash(RANGE) == b""
    distro.use("")
    monkeypatch.setenv("ROS_DISTRO", "foxy")  # an agent needs no definitions
    assert type_hash(RANGE) == b""
