"""Definitions from the descriptions that nodes give of their types."""

import pytest
from support.bag_network import HASH, Network

from uros.interfaces import load, registry
from uros.interfaces.parse import parse_msg
from uros.qos import QoSProfile
from uros.tools.type_lookup import _MOST_TYPES, TypeQuestion, definitions, know_type

PACKAGE = "type_description_interfaces/msg"


def kind(type_id, nested="", capacity=0, string_capacity=0):
    return load(f"{PACKAGE}/FieldType")(
        type_id=type_id, nested_type_name=nested, capacity=capacity, string_capacity=string_capacity
    )


def part(name, *fields):
    made = [load(f"{PACKAGE}/Field")(name=field, type=type_) for field, type_ in fields]
    return load(f"{PACKAGE}/IndividualTypeDescription")(type_name=name, fields=made)


def answer(*parts, **texts):
    """A response that describes the first part, which nests the others."""
    first, *others = parts
    description = load(f"{PACKAGE}/TypeDescription")(
        type_description=first, referenced_type_descriptions=others
    )
    sources = [
        load(f"{PACKAGE}/TypeSource")(
            type_name=f"x_msgs/msg/{name}", encoding="msg", raw_file_contents=text
        )
        for name, text in texts.items()
    ]
    response = load("type_description_interfaces/srv/GetTypeDescription").Response
    return response(type_description=description, type_sources=sources)


def test_every_type_of_a_field():
    constants = load(f"{PACKAGE}/FieldType")
    numbers = {
        name.removeprefix("FIELD_TYPE_"): getattr(constants, name)
        for name in dir(constants)
        if name.startswith("FIELD_TYPE_")
    }
    for name, type_, sizes in (
        ("INT8", "int8", {}),
        ("FLOAT_ARRAY", "float32[3]", {"capacity": 3}),
        ("DOUBLE_BOUNDED_SEQUENCE", "float64[<=4]", {"capacity": 4}),
        ("BOOLEAN_UNBOUNDED_SEQUENCE", "bool[]", {}),
        ("WSTRING", "wstring", {}),
        ("BOUNDED_STRING", "string<=9", {"string_capacity": 9}),
        ("BOUNDED_STRING_ARRAY", "string<=9[2]", {"string_capacity": 9, "capacity": 2}),
        ("NESTED_TYPE", "a/B", {"nested": "a/msg/B"}),
        ("NESTED_TYPE_ARRAY", "a/B[2]", {"nested": "a/msg/B", "capacity": 2}),
        ("NESTED_TYPE_UNBOUNDED_SEQUENCE", "a/B[]", {"nested": "a/msg/B"}),
    ):
        told = answer(part("x_msgs/msg/X", ("f", kind(numbers[name], **sizes))))
        assert definitions(told) == {"x_msgs/msg/X": f"{type_} f\n"}


def test_nested_messages_have_files_too():
    inner = part("x_msgs/msg/Inner", ("a", kind(2)))
    outer = part("x_msgs/msg/Outer", ("inner", kind(1, "x_msgs/msg/Inner")))
    empty = part("x_msgs/msg/Empty", ("structure_needs_at_least_one_member", kind(3)))
    assert definitions(answer(outer, inner, empty)) == {
        "x_msgs/msg/Outer": "x_msgs/Inner inner\n",
        "x_msgs/msg/Inner": "int8 a\n",
        "x_msgs/msg/Empty": "",
    }


def test_the_text_of_the_file_is_preferred():
    text = "# why\nint8 LIMIT=3\nint8 a\n"
    told = answer(part("x_msgs/msg/X", ("a", kind(2))), X=text)
    assert definitions(told) == {"x_msgs/msg/X": text}


def test_a_description_reads_as_a_file():
    header = ("header", kind(1, "std_msgs/msg/Header"))
    told = answer(part("x_msgs/msg/X", header, ("data", kind(147))))
    text = definitions(told)["x_msgs/msg/X"]
    types = [str(field.type) for field in parse_msg(text, "x_msgs", "X", "").fields]
    assert types == ["std_msgs/msg/Header", "uint8[]"]


@pytest.mark.parametrize(
    "told, sentence",
    [
        (answer(part("x/msg/X", ("a", kind(12)))), "unknown type 12"),
        (answer(part("x/msg/X", ("a", kind(250)))), "unknown type 250"),
        (answer(*[part("x/msg/X")] * (_MOST_TYPES + 1)), f"it has {_MOST_TYPES + 1} parts"),
    ],
)
def test_descriptions_that_are_refused(told, sentence):
    with pytest.raises(ValueError, match=sentence):
        definitions(told)


@pytest.mark.parametrize("name", ["../../msg/X", "x/msg/../X", "x/msg/X/Y", "X/msg/X", "/x/msg/X"])
def test_names_that_are_paths_are_left_out(name):
    assert list(definitions(answer(part("x/msg/X"), part(name)))) == ["x/msg/X"]


# --- the nodes ----------------------------------------------------------------------------------

NAME = "asked_msgs/msg/X"
NODES = ("a", "b", "c", "d")


@pytest.fixture
def network():
    """Four nodes that use the type, and can be asked for its definition."""
    network = Network()
    network.publish("/x", QoSProfile(), types=[NAME], type_hash=HASH, nodes=NODES)
    network.describe(*NODES)
    return network


def test_one_node_after_the_other_is_asked_and_three_at_most(network):
    """They do not match, do not answer in time, and do not know the type."""
    network.unmatched.add("/a/get_type_description")
    question = TypeQuestion(network, NAME, 0.0)
    assert not question.turn(0.0) and question.node == "/a"
    assert not question.turn(1.9) and not network.clients[0].requests
    assert not question.turn(2.0) and network.clients[0].closed
    assert not question.turn(2.0) and network.clients[1].requests
    assert not question.turn(4.0) and network.clients[1].closed
    assert not question.turn(4.0)
    network.answer(network.clients[2], "", successful=False)
    assert not question.turn(4.1) and network.clients[2].closed
    assert question.turn(4.1) and question.answer is None
    assert [client.service[1] for client in network.clients] == ["a", "b", "c"]


@pytest.mark.parametrize("wrong", [{"successful": False}, {"name": "asked_msgs/msg/Other"}])
def test_the_next_node_answers(network, wrong):
    question = TypeQuestion(network, NAME, 0.0)
    question.turn(0.0)
    network.answer(network.clients[0], "", **wrong)
    question.turn(0.1)
    question.turn(0.1)
    network.answer(network.clients[1], "int8 a\n")
    assert question.turn(0.2) and question.turn(0.3)
    assert definitions(question.answer) == {NAME: "int8 a\n"} and question.node == "/b"


def test_a_node_may_be_discovered_later(network):
    network.offered_services.clear()
    question = TypeQuestion(network, NAME, 0.0, appears=1.0)
    assert not question.turn(0.9)
    network.describe("d")
    assert not question.turn(0.9) and question.node == "/d"
    question.close()
    question.close()
    assert TypeQuestion(Network(), NAME, 0.0, appears=1.0).turn(1.0)


def test_a_type_is_known_after_a_node_has_answered(network, monkeypatch):
    """Its file is read as any other; the type is forgotten with this test."""
    monkeypatch.setattr(registry, "_added", {})
    network.script = [
        lambda: None, lambda: network.answer(network.clients[0], "int8 LIMIT=3\nint8 a\n"),
    ]  # fmt: skip
    know_type(network, NAME)
    assert registry.exists(NAME) and network.clients[0].closed
    assert [field.name for field in registry.definition(NAME).parts[0].fields] == ["a"]
