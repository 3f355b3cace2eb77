import pytest
from support.graph_network import GraphNetwork
from unit.host.test_graph_queries import STRING, Net

from uros.tools import cli

PRINTED = "Type: std_msgs/msg/String\nPublisher count: {}\nSubscription count: {}\n"


@pytest.mark.parametrize("counts", [(1, 0), (0, 1), (2, 1)])
def test_a_topic_is_there_while_it_has_an_endpoint(monkeypatch, capsys, counts):
    net = Net()
    participant = net.participant()
    for is_writer, count in zip((True, False), counts, strict=True):
        for _ in range(count):
            net.endpoint(participant, "rt/chatter", STRING, is_writer)
    GraphNetwork(net).join(monkeypatch)
    assert cli.main(["topic", "info", "/chatter"]) == 0
    assert capsys.readouterr().out == PRINTED.format(*counts)
    net.endpoints.clear()
    assert cli.main(["topic", "info", "/chatter"]) == 1
    captured = capsys.readouterr()
    assert captured.out == "" and "there is no topic '/chatter' in domain 0" in captured.err
