"""A board's parameters, read and set by rclpy's parameter client."""

import pytest
from support.services_board import board_and_peer
from support.variants import slow_except

pytestmark = pytest.mark.timeout(180)

BOOL, INTEGER, DOUBLE, STRING, OCTETS, BOOLS, INTEGERS, DOUBLES, STRINGS = range(1, 10)
FIELDS = (
    "bool", "integer", "double", "string", "byte_array", "bool_array", "integer_array",
    "double_array", "string_array",
)  # fmt: skip
# The board's parameters that have a value, with types and values as the board declares them.
DECLARED = {
    "bool": (BOOL, True),
    "int": (INTEGER, 4),
    "float": (DOUBLE, 0.5),
    "text": (STRING, "grün"),
    "octets": (OCTETS, [0, 255]),
    "arm.bools": (BOOLS, [True, False]),
    "arm.ints": (INTEGERS, [1, -(2**63)]),
    "arm.left.floats": (DOUBLES, [0.25, -1e300]),
    "arm.left.texts": (STRINGS, ["a", ""]),
    "fixed": (INTEGER, 1),
    "broken": (BOOL, False),
}
NEW = {
    "bool": (BOOL, False),
    "int": (INTEGER, -100),
    "float": (DOUBLE, 0.75),
    "text": (STRING, "x" * 1000),
    "octets": (OCTETS, []),
    "arm.bools": (BOOLS, [True] * 9),
    "arm.ints": (INTEGERS, []),
    "arm.left.floats": (DOUBLES, [5e-324, 1e308]),
    "arm.left.texts": (STRINGS, ["☃", "b" * 500]),
    "any": (DOUBLES, [0.5]),
    "later": (INTEGER, 5),
}


@pytest.fixture(scope="module", params=slow_except(["cpython", "micropython"], "micropython"))
def board(request, ros_python, domain, tmp_path_factory):
    folder = tmp_path_factory.mktemp("parameters")
    with board_and_peer(ros_python, folder, request.param, domain) as (name, peer):
        board = Board(name, peer)
        board.match_events()
        yield board


class Board:
    def __init__(self, name, peer):
        self.name = name
        self.peer = peer

    def ask(self, method, **arguments):
        """Call a method of AsyncParameterClient, and return the response."""
        return self.peer.do(
            "parameters", node=self.name, method=method, seconds=40, **arguments
        )["response"]  # fmt: skip

    def set(self, *parameters):
        """Set each (name, type, value); return (successful, reason) of each."""
        results = self.ask("set_parameters", parameters=parameters)["results"]
        return [(result["successful"], result["reason"]) for result in results]

    def get(self, *names):
        """Return (type, value) of each parameter, as ParameterValue has them."""
        values = self.ask("get_parameters", names=names)["values"]
        return [
            (value["type"], value[FIELDS[value["type"] - 1] + "_value"] if value["type"] else None)
            for value in values
        ]

    def match_events(self):
        """Set a parameter until its event arrives: the services may match before the topic does."""
        while not self.peer.do("parameter_events", node=self.name, count=1, seconds=0.3)["events"]:
            assert self.set(("bool", BOOL, True)) == [(True, "")]
        # Those of earlier rounds that were only late.
        self.peer.do("parameter_events", node=self.name, count=100, seconds=0.5)

    def events(self, count):
        events = self.peer.do("parameter_events", node=self.name, count=count)["events"]
        assert len(events) == count, events
        return events


def names_of(parameters):
    return [parameter["name"] for parameter in parameters]


def test_every_type_is_read_and_set(board):
    assert board.get(*DECLARED) == list(DECLARED.values())
    assert board.ask("get_parameter_types", names=list(DECLARED))["types"] == [
        kind for kind, _ in DECLARED.values()
    ]
    assert board.get("any") == [(0, None)]
    wanted = [(name, *new) for name, new in NEW.items()]
    assert board.set(*wanted) == [(True, "")] * len(NEW)
    assert board.get(*NEW) == list(NEW.values())
    events = board.events(len(NEW))
    for event, (name, (kind, value)) in zip(events, NEW.items(), strict=True):
        changed = event["new_parameters"] + event["changed_parameters"]
        assert names_of(changed) == [name] and event["deleted_parameters"] == []
        assert bool(event["new_parameters"]) == (name in ("any", "later"))
        assert changed[0]["value"]["type"] == kind
        assert changed[0]["value"][FIELDS[kind - 1] + "_value"] == value
        assert event["stamp"]["sec"] > 1_700_000_000
    back = [(name, *DECLARED[name]) for name in NEW if name in DECLARED]
    assert board.set(*back) == [(True, "")] * len(back)
    board.events(len(back))


def test_lists_by_prefix_and_depth(board):
    everything = [*DECLARED, "any", "later"]
    arm = [name for name in everything if name.startswith("arm.")]

    def names(**arguments):
        result = board.ask("list_parameters", **arguments)["result"]
        return sorted(result["names"]), sorted(result["prefixes"])

    assert names() == (sorted(everything), ["arm", "arm.left"])
    assert names(depth=1) == (sorted(set(everything) - set(arm)), [])
    assert names(prefixes=["arm"]) == (sorted(arm), ["arm", "arm.left"])
    assert names(prefixes=["arm"], depth=1) == (["arm.bools", "arm.ints"], ["arm"])
    assert names(prefixes=["arm.left", "int"]) == (
        ["arm.left.floats", "arm.left.texts", "int"], ["arm.left"],
    )  # fmt: skip
    assert names(prefixes=["none"]) == ([], [])


def test_descriptions(board):
    described = board.ask("describe_parameters", names=["int", "float", "fixed", "any", "text"])
    whole, ranged, fixed, dynamic, text = described["descriptors"]
    assert whole == {
        "name": "int", "type": INTEGER, "description": "how many",
        "additional_constraints": "no 13", "read_only": False, "dynamic_typing": False,
        "floating_point_range": [],
        "integer_range": [{"from_value": -100, "to_value": 100, "step": 1}],
    }  # fmt: skip
    assert ranged["floating_point_range"] == [{"from_value": 0.0, "to_value": 1.0, "step": 0.25}]
    assert fixed["read_only"] and dynamic["dynamic_typing"]
    assert (text["name"], text["type"], text["integer_range"]) == ("text", STRING, [])


@pytest.mark.parametrize(
    ("parameter", "reason"),
    [
        (("int", INTEGER, 101), "out of range"),
        (("float", DOUBLE, 0.3), "no step"),
        (("int", DOUBLE, 1.0), "expected INTEGER, got DOUBLE"),
        (("int", INTEGER, 13), "13 brings bad luck"),
        (("int", INTEGER, 99), "99 is a trap"),
        (("fixed", INTEGER, 2), "read-only"),
        (("none", INTEGER, 2), "not declared"),
    ],
    ids=lambda value: value.replace(" ", "_") if isinstance(value, str) else value[0],
)
def test_a_refused_parameter_has_a_reason_and_changes_nothing(board, parameter, reason):
    before = board.get("int", "float", "fixed", "bool")
    flipped = not before[3][1]
    results = board.set(parameter, ("bool", BOOL, flipped))
    ((success, text), (flip_success, flip_text)) = results
    assert not success and reason in text and flip_success and flip_text == ""
    both = [("bool", BOOL, not flipped), parameter]
    result = board.ask("set_parameters_atomically", parameters=both)["result"]
    assert not result["successful"] and reason in result["reason"]
    assert board.get("int", "float", "fixed", "bool") == [*before[:3], (BOOL, flipped)]
    board.events(1)


def test_parameters_are_set_atomically(board):
    both = [("int", INTEGER, 7), ("text", STRING, "together")]
    result = board.ask("set_parameters_atomically", parameters=both)["result"]
    assert result == {"successful": True, "reason": ""}
    assert board.get("int", "text") == [(INTEGER, 7), (STRING, "together")]
    (event,) = board.events(1)
    assert names_of(event["changed_parameters"]) == ["int", "text"]


def test_deleting_parameters(board):
    """rclpy deletes a parameter by setting it to type NOT_SET, which needs dynamic typing."""
    board.set(("any", STRING, "something"))
    board.events(1)
    results = board.ask("delete_parameters", names=["any", "text"])["results"]
    assert [result["successful"] for result in results] == [True, False]
    assert "static type" in results[1]["reason"]
    (event,) = board.events(1)
    assert names_of(event["deleted_parameters"]) == ["any"]
    assert board.ask("get_parameters", names=["any"])["values"] == []


def test_dump_and_load(board, tmp_path):
    """A YAML file in the form of ros2 param dump is set as by ros2 param load."""
    file = tmp_path / "board.yaml"
    file.write_text(
        f"{board.name}:\n  ros__parameters:\n    int: -7\n    text: from a file\n"
        "    arm:\n      ints: [4, 5]\n      left:\n        texts: [x]\n"
    )
    results = board.ask("load_parameter_file", parameter_file=str(file), use_wildcard=True)
    assert [result["successful"] for result in results["results"]] == [True] * 4
    assert board.get("int", "text", "arm.ints", "arm.left.texts") == [
        (INTEGER, -7), (STRING, "from a file"), (INTEGERS, [4, 5]), (STRINGS, ["x"]),
    ]  # fmt: skip
    board.events(4)
