"""``uros doctor --report``: the parts of the report, and the options of ros2."""

import json
import platform
from types import SimpleNamespace

import pytest
from unit.host.test_graph_queries import Net

from uros.host import network as network_module
from uros.host.graph_queries import Graph
from uros.host.network import Network
from uros.qos import ReliabilityPolicy
from uros.tools import cli
from uros.tools.doctor import command
from uros.tools.doctor.finding import note, problem
from uros.tools.doctor.report import Report

STRING = "std_msgs::msg::dds_::String_"


@pytest.fixture
def net(monkeypatch):
    """A graph with a publisher that one of two subscriptions cannot hear."""
    net = Net()
    participant = net.participant()
    best_effort = {"reliability": ReliabilityPolicy.BEST_EFFORT}
    net.endpoint(participant, "rt/chatter", STRING, True, **best_effort)
    net.endpoint(participant, "rt/chatter", STRING, False, **best_effort)
    net.endpoint(participant, "rt/chatter", STRING, False)
    monkeypatch.setattr(network_module, "Graph", lambda source: Graph(net))
    monkeypatch.setattr(Network, "settle", lambda network, seconds=0.0: None)
    return net


def test_the_report(net, own_domain_id, capsys):
    assert cli.main(["doctor", "-r", "--domain", str(own_domain_id)]) == 0
    lines = capsys.readouterr().out.splitlines()
    titles = [line.strip() for line in lines if line.startswith("   ")]
    assert titles == [
        "PLATFORM INFORMATION", "PACKAGE VERSIONS", "MIDDLEWARE", "ENVIRONMENT",
        "NETWORK CONFIGURATION", f"TOPIC LIST of domain {own_domain_id}",
        f"QOS COMPATIBILITY LIST of domain {own_domain_id}",
    ]  # fmt: skip
    assert f"release          : {platform.release()}" in lines
    assert "publisher count     : 1" in lines and "subscriber count    : 2" in lines
    status = [line for line in lines if line.startswith("compatibility status")]
    assert sorted(line.partition(": ")[2] for line in status) == [
        "ERROR: reliability offered is best_effort, requested reliable", "OK",
    ]  # fmt: skip


def test_the_report_as_json_without_packages(net, own_domain_id, capsys):
    command_line = ["doctor", "--report", "-ep", "--json", "--domain", str(own_domain_id)]
    assert cli.main(command_line) == 0
    parts = {part["title"]: part["items"] for part in json.loads(capsys.readouterr().out)}
    assert "PACKAGE VERSIONS" not in parts
    assert ["topic", "/chatter"] in parts[f"TOPIC LIST of domain {own_domain_id}"]


def test_the_form_of_a_part():
    part = Report("TITLE", [("a", "1"), ("a longer name", "2\x1b[2J")])
    assert part.lines() == ["", "   TITLE", "a                : 1", "a longer name    : 2\\x1b[2J"]
    assert Report("TITLE", [("a", "1")]).lines()[2] == "a       : 1"


@pytest.mark.parametrize(
    "finding, options, status, reported",
    [
        (note("x", "odd"), [], 0, False),
        (note("x", "odd"), ["-iw"], 1, False),
        (note("x", "odd"), ["-rf"], 0, False),
        (note("x", "odd"), ["-iw", "-rf"], 1, True),
        (problem("x", "bad", "mend"), ["--report-failed"], 1, True),
    ],
)
def test_notes_and_failed_checks(monkeypatch, capsys, finding, options, status, reported):
    told = []
    monkeypatch.setattr(command.Doctor, "examine", lambda doctor: doctor._found([finding]))
    monkeypatch.setattr(command, "_report", told.append)
    monkeypatch.setattr(command, "Agents", lambda pid: SimpleNamespace())
    assert cli.main(["doctor", *options]) == status
    assert bool(told) == reported
