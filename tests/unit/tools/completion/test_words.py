"""What may come next on a command line: commands, options, choices, names."""

import sys

import pytest

from uros.tools.completion import details, names
from uros.tools.completion.words import complete


def words(line):
    return [word for word, _ in complete(line.split(" "))]


@pytest.mark.parametrize(
    "line, some",
    [
        ("topi", ["topic"]),
        ("topic ec", ["echo"]),
        ("topic --incl", ["--include-hidden-topics"]),
        ("topic --include-hidden-topics lis", ["list"]),
        ("--v", ["--version"]),
        ("topic echo /x --onc", ["--once"]),
        ("topic echo --qos-reliability rel", ["reliable"]),
        ("topic echo --qos-reliability=rel", ["--qos-reliability=reliable"]),
        ("topic pub /x std_msgs/msg/Int64", ["std_msgs/msg/Int64", "std_msgs/msg/Int64MultiArray"]),
        ("service call /x std_srvs/srv/Tri", ["std_srvs/srv/Trigger"]),
        ("interface show --distro hum", ["humble"]),
        ("interface package std_m", ["std_msgs"]),
        ("agent ud", ["udp4", "udp6"]),
        ("agent udp4 --por", ["--port"]),
        ("board run sprt", ["sprturtlebot", "sprturtlebot_pid"]),
        ("board build . out --board pic", ["pico", "pico_w"]),
        ("completion z", ["zsh"]),
        # a topic that is not typed yet, no number for a domain, an unknown type
        ("topic echo --field ", []),
        ("topic echo --domain x ", []),
        ("topic echo /x no_msgs/msg/Missing --field ", []),
        # nothing is known: the shell completes files
        ("trace cap", []),
        ("nothing ", []),
        ("agent quic --p", []),
    ],
)
def test_words(monkeypatch, line, some):
    monkeypatch.setattr(details, "_types", lambda typed: {})
    assert sorted(words(line)) == some


def test_candidates_have_descriptions():
    assert ("list", "list topics") in complete(["topic", ""])
    assert dict(complete(["topic", "hz", "--window"]))["--window"].startswith("average over")


def test_only_the_module_of_the_verb_is_imported(monkeypatch):
    monkeypatch.delitem(sys.modules, "uros.tools.capture.trace", raising=False)
    words("topic echo --")
    assert "uros.tools.capture.trace" not in sys.modules


def test_names_of_the_network(monkeypatch):
    """They are those of the domain of the line; the first slash may be left away."""
    asked = []

    def graph(typed, query):
        asked.append(typed.given.get("domain"))
        return ["/chatter", "/lab/chat"]

    monkeypatch.setattr(names, "_graph", graph)
    for line in (
        "topic echo --domain 7 /cha", "topic hz --domain 7 /x /cha", "node info --domain 7 /cha",
        "service call --domain=7 /cha",
    ):  # fmt: skip
        assert words(line) == ["/chatter"]
    assert words("topic echo --domain 7 cha") == ["chatter"]
    assert asked == [["7"]] * 5
