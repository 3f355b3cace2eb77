"""Names that come close to an unknown one."""

import pytest

from uros.similar import closest

TRANSPORTS = ("udp4", "udp6", "tcp4", "serial", "multiserial")
TYPES = [
    f"std_msgs/msg/{name}"
    for name in (
        "Int16", "Int32", "Int64", "Int8", "Int8MultiArray", "UInt8", "UInt16", "String", "Bool",
    )
]  # fmt: skip


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
        # a beginning that lacks a letter or two: all of them, and nothing that is less close
        ("std_msgs/msg/Int", TYPES, [f"std_msgs/msg/Int{bits}" for bits in (8, 16, 32, 64)]),
        ("std_msgs/msg/Strin", TYPES, ["std_msgs/msg/String"]),
        ("Nod", ("node", "Node"), ["Node"]),
        ("udp", ("upd", "udp_multicast", "udp4"), ["udp4"]),
        ("mul", ("mull_and_more", "mut"), ["mut"]),
        (
            "/lab",
            ("/lab/cmd_vel", "/lab/odom", "/lab/a_very_long_name"),
            ["/lab/odom", "/lab/cmd_vel"],
        ),
        # one letter is wrong, or two of a long name
        ("std_msgs/msg/Sting", TYPES, ["std_msgs/msg/String"]),
        ("std_msgs/msg/Srtnig", TYPES, ["std_msgs/msg/String"]),
        ("std_msgs/msg/Int33", TYPES, ["std_msgs/msg/Int32"]),
        ("speed_z", ("speed_x", "speed_y", "speeds"), ["speed_x", "speed_y"]),
        ("ab", ("ac",), []),
    ],
)
def test_the_closest_names_come_first(name, known, close):
    assert closest(name, known) == close
