"""Two ROS nodes tell each other of their types, and Cyclone, in the agent, overhears it.

It could not read what Fast DDS says of sequences, held every type with one for invalid, and let no
endpoint of it in that came later: see ``_COMPATIBILITY`` in ``middleware/dds/config.py``.
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
        """What a publisher says before Cyclone has met it may be lost, so it says it again."""
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
    with RosPeer(ros_python, domain) as other:  # asks about all types that it meets
        infos = other.do("topic", topic=topics[0])["infos"]
        assert [it["type"] for it in infos] == [JOINTS]
        assert hears(other, 0, 2.0)
        assert hears(peer, 1, 3.0)
    client.close()
