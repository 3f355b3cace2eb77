"""Names for completion that are found in the domain."""

from support.spinning import spinning_network

from uros.host.network import Network
from uros.names import topic_to_dds
from uros.qos import QoSProfile
from uros.tools.completion.words import complete


def test_topics_of_the_domain(own_domain_id):
    network = Network(own_domain_id, "rtps")
    for name in ("/completed", "/not valid"):
        network.node.create_writer(topic_to_dds(name), "std_msgs::msg::dds_::String_", QoSProfile())
    with spinning_network(network):
        line = ["topic", "echo", "--domain", str(own_domain_id), ""]
        assert ("/completed", "") in complete(line)
        assert ("/not valid", "") not in complete(line)
