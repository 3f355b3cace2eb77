"""Type lookup between two ROS nodes must not make Cyclone, in the agent, reject their endpoints.

Cyclone also receives the TypeObjects that Fast DDS nodes send each other. It could not read those
of sequences, took every type with a sequence for invalid, and rejected endpoints of such a type
that were discovered later: see ``_COMPATIBILITY`` in ``middleware/dds/config.py``.
"""

import pytest
from support.client import XrceClient
from support.peer import RosPeer

from uros.interfaces import load as load_type
from uros.interfaces.codec import to_cdr

JOINTS = "sensor_msgs/msg/JointState"

pytestmark = pytest.mark.timeout(120)


def test_a_board_hears_publishers_that_come_after_a_type_lookup(agent, peer, ros_python, domain):
    client = XrceClient(agent.line(), key=0x51)
    client.open()
    topics = ["/early", "/late"]
    readers = [
        client.reader("node", "rt" + topic, "sensor_msgs::msg::dds_::JointState_")
        for topic in topics
    ]
    message = load_type(JOINTS)(name=["elbow"])

    def hears(node, number, position):
        """Publish until the board receives the sample: those from before the match are lost."""
        message.position = [position]
        sample = to_cdr(message)
        for _ in range(20):
            node.do("publish", topic=topics[number], type=JOINTS, cdr=[sample.hex()])
            while client.wait_sample(readers[number], 0.5):
                if client.sample(readers[number]).startswith(sample[4:]):
                    return True
        return False

    for reader in readers:
        client.read(reader)
    assert hears(peer, 0, 1.0)
    with RosPeer(ros_python, domain) as second:  # looks up all types that it discovers
        infos = second.do("topic", topic=topics[0])["infos"]
        assert [info["type"] for info in infos] == [JOINTS]
        assert hears(second, 0, 2.0)
        assert hears(peer, 1, 3.0)
    client.close()
