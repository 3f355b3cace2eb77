"""``uros topic find`` and ``uros topic type``, in a domain of the test's own."""

import pytest
from support.spinning import spinning_network

from uros.host.network import Network
from uros.qos import QoSProfile
from uros.tools import cli


@pytest.fixture
def topics(own_domain_id):
    """Two topics of strings, one of them hidden, in the domain whose options it returns."""
    network = Network(own_domain_id)
    for topic in ("/chatter", "/_secret"):
        network.listen(topic, "std_msgs/msg/String", QoSProfile(), print)
    with spinning_network(network):
        yield ["--domain", str(own_domain_id)]


def test_topics_of_a_type(topics, capsys):
    for wanted in ("std_msgs/msg/String", "std_msgs/String"):
        assert cli.main(["topic", "find", wanted, *topics]) == 0
        assert capsys.readouterr().out == "/chatter\n"
    hidden = ["topic", "find", "std_msgs/msg/String", "--include-hidden-topics"]
    assert cli.main([*hidden, *topics]) == 0
    assert capsys.readouterr().out == "/_secret\n/chatter\n"
    assert cli.main([*hidden, "-c", *topics]) == 0
    assert capsys.readouterr().out == "2\n"


def test_a_type_that_no_topic_has(topics, capsys):
    assert cli.main(["topic", "find", "std_msgs/msg/Bool", *topics]) == 0
    captured = capsys.readouterr()
    assert captured.out == "" and "no definition" not in captured.err
    assert cli.main(["topic", "find", "std_msgs/msg/Strin", "-c", *topics]) == 0
    captured = capsys.readouterr()
    assert captured.out == "0\n" and "did you mean 'std_msgs/msg/String'" in captured.err


def test_the_type_of_a_topic(topics, capsys):
    for name in ("/chatter", "chatter"):
        assert cli.main(["topic", "type", name, *topics]) == 0
        assert capsys.readouterr().out == "std_msgs/msg/String\n"
    assert cli.main(["topic", "type", "/_secret", *topics]) == 0
    assert capsys.readouterr().out == "std_msgs/msg/String\n"
    assert cli.main(["topic", "type", "/chater", *topics]) == 1
    captured = capsys.readouterr()
    assert captured.out == ""
    assert "there is no topic '/chater'" in captured.err
    assert "did you mean '/chatter'?" in captured.err
