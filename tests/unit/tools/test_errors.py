"""Suggestions for names that are unknown."""

import pytest

from uros.tools.errors import closest, did_you_mean

TRANSPORTS = ("udp4", "udp6", "tcp4", "serial", "multiserial")


@pytest.mark.parametrize(
    "name, known, close",
    [
        ("udp", TRANSPORTS, ["udp4", "udp6"]),
        ("UDP4", TRANSPORTS, ["udp4"]),
        ("multi", TRANSPORTS, ["multiserial"]),  # a beginning, however short beside the whole
        ("m", TRANSPORTS, []),
        ("quic", TRANSPORTS, []),
        ("std_msg", ("test_msgs", "std_srvs", "std_msgs"), ["std_msgs"]),
        (
            "std_srvs/srv/Triger",
            ("std_srvs/srv/Empty", "std_srvs/srv/Trigger"),
            ["std_srvs/srv/Trigger"],
        ),
        ("/chater", ("/chatter", "/rosout"), ["/chatter"]),
        ("/chatter", ("/rosout", "/robot_in_the_hall/chatter"), ["/robot_in_the_hall/chatter"]),
        ("/", ("/a/", "/b"), []),
        ("a", ("a", "a"), ["a"]),
        ("nwe", ("list", "new", "run"), ["new"]),
    ],
)
def test_the_closest_names_come_first(name, known, close):
    assert closest(name, known) == close


def test_the_words():
    assert did_you_mean("udp", TRANSPORTS) == "; did you mean 'udp4' or 'udp6'?"
    assert did_you_mean("zzz", TRANSPORTS) == ""
