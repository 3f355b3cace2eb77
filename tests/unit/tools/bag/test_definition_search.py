"""Definitions that nodes are asked for while a bag is recorded."""

import pytest
from support.bag_network import HASH, Network
from unit.tools.test_type_lookup import answer, kind, part

from uros.qos import QoSProfile
from uros.tools.bag import definition_search
from uros.tools.bag.definition_search import DefinitionSearch, text_of

LATE = 1000.0


def network_of(*types, nodes=("talker",)):
    network = Network()
    network.describe(*nodes)
    for number, name in enumerate(types):
        network.publish(
            f"/t{number}", QoSProfile(), types=[name], type_hash=HASH, nodes=nodes
        )  # fmt: skip
    return network


def test_types_are_asked_for_at_the_same_time_up_to_a_limit(monkeypatch):
    monkeypatch.setattr(definition_search, "_AT_ONCE", 2)
    monkeypatch.setattr(definition_search, "_MOST_WAITING", 3)
    types = [f"x_msgs/msg/X{number}" for number in range(4)]
    network = network_of(*types)
    search = DefinitionSearch(network)
    assert [search.begin(name) for name in types] == [True, True, True, False]
    for _ in range(2):
        assert search.turn(0.0) == []
    first, second = network.clients
    network.answer(second, "int8 b\n")
    (found,) = search.turn(0.1)
    assert found == ("x_msgs/msg/X1", "int8 b\n", "/talker", "")
    search.turn(0.2)
    assert len(network.clients) == 3 and not first.closed
    search.close()
    search.close()
    assert all(client.closed for client in network.clients)
    assert search.turn(LATE) == []


@pytest.mark.parametrize("bad", ["int8 9a\n", "y_msgs/Missing a\n"])
def test_a_definition_that_is_none_is_refused(bad):
    network = network_of("x_msgs/msg/X")
    search = DefinitionSearch(network)
    search.begin("x_msgs/msg/X")
    for _ in range(2):
        search.turn(0.0)
    network.answer(network.clients[0], bad)
    (found,) = search.turn(0.1)
    assert (found.text, found.node) == ("", "")
    assert found.fault.startswith("that of /talker cannot be used: ")


def test_the_text_has_the_nested_messages_behind_the_root():
    inner = part("x_msgs/msg/Inner", ("a", kind(2)))
    outer = part("x_msgs/msg/Outer", ("inner", kind(1, "x_msgs/msg/Inner")))
    assert text_of(answer(outer, inner)) == (
        f"x_msgs/Inner inner\n\n{'=' * 80}\nMSG: x_msgs/Inner\nint8 a\n"
    )
