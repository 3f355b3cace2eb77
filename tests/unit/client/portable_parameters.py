"""Parameters of a node, for its program and over its services. Also runs on MicroPython."""

from support.services import Bench, raised

from uros.client.parameters import (
    FloatingPointRange,
    IntegerRange,
    InvalidParameterException,
    InvalidParameterTypeException,
    InvalidParameterValueException,
    Parameter,
    ParameterAlreadyDeclaredException,
    ParameterDescriptor,
    ParameterException,
    ParameterImmutableException,
    ParameterNotDeclaredException,
    ParameterServer,
    ParameterUninitializedException,
    SetParametersResult,
)

Type = Parameter.Type
Kind = type(Type.BOOL)
# One value of each type, by its number.
VALUES = (
    None, True, -5, 0.5, "grün", b"\x00\xff", [True, False], [1, -(2**63)], [0.25, -1e300],
    ["a", ""],
)  # fmt: skip
NOTHING = [False, 0, 0.0, "", b"", [], [], [], []]
NODE = "/node"
SET = NODE + "/set_parameters"
GET = NODE + "/get_parameters"
EVENTS = "/parameter_events"


def wire(name, kind, value):
    """Return the values of a Parameter message."""
    values = [name, kind] + NOTHING
    if 0 < kind < 10:
        values[kind + 1] = value
    return values


def declared(**options):
    """Return the bench of a connected node with a parameter of each type, p1 to p9."""
    bench = Bench(connect=False)
    ParameterServer(bench.node, **options)
    for kind in range(1, 10):
        bench.node.declare_parameter("p%d" % kind, VALUES[kind])
    bench.connect()
    bench.agent.samples.clear()
    return bench


def fresh(name, value, descriptor=None, **options):
    """Return a node with this parameter."""
    node = Bench(connect=False, **options).node
    node.declare_parameter(name, value, descriptor)
    return node


def refusal(node, name, value):
    """Set the value; return why it is refused, or "" if it is accepted."""
    (result,) = node.set_parameters([Parameter(name, value=value)])
    if result.successful:
        assert node.get_parameter(name).value == value
        assert not result.reason
    else:
        assert result.reason
    return result.reason


# --- values and types -------------------------------------------------------------------------


def test_types_have_the_numbers_of_rcl_interfaces() -> None:
    names = (
        "NOT_SET BOOL INTEGER DOUBLE STRING BYTE_ARRAY BOOL_ARRAY INTEGER_ARRAY DOUBLE_ARRAY"
        " STRING_ARRAY"
    ).split()
    types = (
        Type.NOT_SET, Type.BOOL, Type.INTEGER, Type.DOUBLE, Type.STRING, Type.BYTE_ARRAY,
        Type.BOOL_ARRAY, Type.INTEGER_ARRAY, Type.DOUBLE_ARRAY, Type.STRING_ARRAY,
    )  # fmt: skip
    for number in range(10):
        kind = types[number]
        assert kind == number and kind.value == number and kind.name == names[number]
        assert isinstance(kind, Kind)
        parameter = Parameter("x", kind, VALUES[number])
        assert parameter.type_ == kind and parameter.type_ is not number
        assert Parameter("x", value=VALUES[number]).type_ == kind


def test_a_value_is_of_one_type_and_kept_as_it_is() -> None:
    for kind in range(10):
        for other_kind in range(10):
            if kind == other_kind:
                assert Parameter("x", kind, VALUES[kind]).value == VALUES[kind]
            else:
                raised(ValueError, Parameter, "x", kind, VALUES[other_kind])
    for kind in range(5, 10):
        assert Parameter("x", kind, []).value == (b"" if kind == 5 else [])
    assert Parameter("x", value=[]).type_ == Type.BYTE_ARRAY  # as rclpy has it
    assert Parameter("x", value=(1, 2)).value == [1, 2]
    assert Parameter("x", value=[b"\x01", b"\x02"]).value == b"\x01\x02"
    assert Parameter("x", value=bytearray(b"ab")).value == b"ab"


def test_values_of_other_types_are_refused() -> None:
    for value in (object(), {"a": 1}, [None], [[1]], [object()], print):
        raised(TypeError, Parameter, "x", None, value)
    for value in (2**63, -(2**63) - 1, [2**63], [1, True], [1, "a"], [True, 1], [0.5, 1]):
        raised(ValueError, Parameter, "x", None, value)
    raised(ValueError, Parameter, "x", Type.BYTE_ARRAY, [b"ab"])
    raised(ValueError, Parameter, "x", Type.INTEGER, True)
    raised(ValueError, Parameter, "x", Type.INTEGER_ARRAY, 5)
    raised(ValueError, Parameter, "x", 77, 5)


def test_a_value_as_a_message_and_back() -> None:
    class Message:
        name = "x"

    for kind in range(10):
        Message.value = Parameter("x", value=VALUES[kind]).get_parameter_value()
        assert Message.value.type == kind
        back = Parameter.from_parameter_msg(Message)
        assert (back.name, back.kind, back.value) == ("x", kind, VALUES[kind])
    value = Parameter("x", value=7).get_parameter_value()
    assert value.integer_value == 7 and value.string_value == "" and value.double_value == 0.0


# --- declaring --------------------------------------------------------------------------------


def test_declare_returns_the_parameter() -> None:
    node = Bench(connect=False).node
    for kind in range(1, 10):
        parameter = node.declare_parameter("p%d" % kind, VALUES[kind])
        assert (parameter.name, parameter.value, parameter.type_) == (
            "p%d" % kind,
            VALUES[kind],
            kind,
        )
        assert node.get_parameter("p%d" % kind).value == VALUES[kind]
        assert node.has_parameter("p%d" % kind)
        assert node.get_parameter_type("p%d" % kind) == kind
    assert not node.has_parameter("p10")
    assert [parameter.value for parameter in node.get_parameters(["p2", "p1"])] == [-5, True]
    assert node.get_parameter_types(["p4", "p9"]) == [4, 9]


def test_declare_refuses_what_rclpy_refuses() -> None:
    node = fresh("a", 1)
    text = raised(ParameterAlreadyDeclaredException, node.declare_parameter, "a", 2)
    assert "a is declared already" in text
    raised(InvalidParameterException, node.declare_parameter, "", 2)
    raised(InvalidParameterException, node.declare_parameter, None, 2)
    raised(TypeError, node.declare_parameter, "b", {})
    raised(ValueError, node.declare_parameter, "b", Type.NOT_SET)
    dynamic = ParameterDescriptor(dynamic_typing=True)
    raised(ValueError, node.declare_parameter, "b", Type.INTEGER, dynamic)
    raised(ValueError, node.declare_parameter, "b", None, ParameterDescriptor())
    limits = ParameterDescriptor(integer_range=[IntegerRange(0, 5)])
    text = raised(InvalidParameterValueException, node.declare_parameter, "b", 6, limits)
    assert "b: 6 is out of range, 0 to 5" in text
    assert not node.has_parameter("b")
    assert issubclass(InvalidParameterTypeException, ParameterException)


def test_a_type_without_a_value() -> None:
    node = fresh("a", Type.DOUBLE)
    text = raised(ParameterUninitializedException, node.get_parameter, "a")
    assert "a has no value yet" in text
    assert node.get_parameter_or("a").value is None
    assert node.get_parameter_or("a", Parameter("b", value=1)).value == 1
    assert node.describe_parameter("a").type == Type.DOUBLE
    assert "expected DOUBLE, got INTEGER" in refusal(node, "a", 5)
    assert not refusal(node, "a", 5.0)
    assert node.get_parameter_or("a", Parameter("b", value=1)).value == 5.0


def test_declare_parameters_with_a_namespace() -> None:
    node = Bench(connect=False).node
    limits = ParameterDescriptor(integer_range=[IntegerRange(0, 9)])
    parameters = node.declare_parameters("arm", [("speed", 5, limits), ("name", "left"), ("any",)])
    assert [parameter.name for parameter in parameters] == ["arm.speed", "arm.name", "arm.any"]
    assert "out of range" in refusal(node, "arm.speed", 10)
    assert not refusal(node, "arm.any", "text") and not refusal(node, "arm.any", 1)
    node.declare_parameters("", [("armed", True)])
    parameters_of_arm = node.get_parameters_by_prefix("arm")
    assert (
        sorted(parameters_of_arm) == ["any", "name", "speed"]
        and parameters_of_arm["speed"].value == 5
    )
    assert len(node.get_parameters_by_prefix("")) == 4


def test_overrides_take_precedence_over_declared_values() -> None:
    node = Bench(connect=False).node
    ParameterServer(node, overrides={"a": 7, "b": "text", "c": 3})
    assert node.declare_parameter("a", 1).value == 7
    assert node.declare_parameter("c", 1, None, True).value == 1  # ignore_override
    text = raised(InvalidParameterTypeException, node.declare_parameter, "b", 1)
    assert "expected INTEGER, got STRING" in text
    assert "make the server first" in raised(ValueError, ParameterServer, node)


def test_undeclared_names() -> None:
    node = fresh("a", 1)
    for call in (
        node.get_parameter, node.get_parameter_type, node.describe_parameter,
        node.undeclare_parameter,
    ):  # fmt: skip
        assert "b is not declared" in raised(ParameterNotDeclaredException, call, "b")
    parameters = [Parameter("a", value=2), Parameter("b", value=2)]
    raised(ParameterNotDeclaredException, node.set_parameters_atomically, parameters)
    assert node.get_parameter("a").value == 1
    node.undeclare_parameter("a")
    assert not node.has_parameter("a")
    node.declare_parameter("a", "another type")


def test_undeclared_names_where_they_are_allowed() -> None:
    node = Bench(connect=False).node
    ParameterServer(node, allow_undeclared=True)
    assert node.get_parameter("b").value is None and node.get_parameter_type("b") == 0
    assert node.describe_parameter("b").name == ""
    assert not refusal(node, "b", 5) and not refusal(node, "b", "text")
    assert node.describe_parameter("b").dynamic_typing
    assert node.describe_parameter("b").type == Type.STRING
    (result,) = node.set_parameters([Parameter("b")])
    assert result.successful and not node.has_parameter("b")


# --- rules ------------------------------------------------------------------------------------


def test_a_type_is_kept_unless_it_is_dynamic() -> None:
    node = fresh("a", 1)
    for kind in range(1, 10):
        reason = refusal(node, "a", VALUES[kind])
        assert (reason == "") == (kind == 2), reason
    reason = refusal(node, "a", None)
    assert "cannot be undeclared" in reason and node.has_parameter("a")
    node = fresh("a", None, ParameterDescriptor(dynamic_typing=True))
    assert node.get_parameter("a").value is None
    for kind in range(1, 10):
        assert not refusal(node, "a", VALUES[kind])
        assert node.describe_parameter("a").type == kind
    (result,) = node.set_parameters([Parameter("a")])
    assert result.successful and not node.has_parameter("a")


def test_read_only() -> None:
    node = fresh("a", 1, ParameterDescriptor(read_only=True))
    assert "a is read-only" in refusal(node, "a", 2)
    raised(ParameterImmutableException, node.undeclare_parameter, "a")
    raised(ParameterImmutableException, node.set_descriptor, "a", ParameterDescriptor())
    assert node.get_parameter("a").value == 1


def test_ranges_of_integers() -> None:
    for low, high in ((-10, 10), (10, -10)):
        limits = ParameterDescriptor(integer_range=[IntegerRange(low, high, 3)])
        node = fresh("a", 2, limits)
        for value in range(-13, 14):
            reason = refusal(node, "a", value)
            if not -10 <= value <= 10:
                assert "a: %d is out of range, -10 to 10 by 3" % value == reason
            elif (value + 10) % 3 and value != 10:  # the ends always fit
                assert "a: %d is no step of its range, -10 to 10 by 3" % value == reason
            else:
                assert reason == ""
    node = fresh("a", 2, ParameterDescriptor(integer_range=[IntegerRange(0, 5)]))
    assert [n for n in range(-2, 8) if not refusal(node, "a", n)] == [0, 1, 2, 3, 4, 5]
    wide = [IntegerRange(-(2**63), 2**63 - 1, 2)]
    node = fresh("a", 0, ParameterDescriptor(integer_range=wide))
    assert refusal(node, "a", 1) and not refusal(node, "a", 2**63 - 1)


def test_ranges_of_floats() -> None:
    limits = ParameterDescriptor(floating_point_range=[FloatingPointRange(-1.0, 1.0, 0.3)])
    node = fresh("a", -1.0, limits)
    for value in (-1.0, -0.7, -0.4, -0.1, 0.2, 0.5, 0.8, 1.0, 0.2000000001, 1.0000000001):
        assert not refusal(node, "a", value), value
    for value in (0.0, 0.21, -0.69, 0.99):
        assert "no step" in refusal(node, "a", value), value
    for value in (1.1, -1.1, 1e300, float("inf"), float("-inf"), float("nan")):
        (result,) = node.set_parameters([Parameter("a", value=value)])
        assert "out of range" in result.reason, value
    node = fresh("a", 0.5, ParameterDescriptor(floating_point_range=[FloatingPointRange(0.0, 1.0)]))
    assert not refusal(node, "a", 0.123456) and refusal(node, "a", 1.5)


def test_a_descriptor_serves_many_parameters() -> None:
    limits = ParameterDescriptor(description="any", integer_range=[IntegerRange(0, 5)])
    node = fresh("a", 1, limits)
    node.declare_parameter("b", 2.5, limits)
    first, second = node.describe_parameters(["a", "b"])
    assert (first.name, first.type, second.name, second.type) == ("a", 2, "b", 3)
    assert first.description == second.description == "any" and limits.name == ""


def test_a_new_descriptor() -> None:
    node = fresh("a", 7)
    small = ParameterDescriptor(type=2, integer_range=[IntegerRange(0, 5)])
    text = raised(InvalidParameterValueException, node.set_descriptor, "a", small)
    assert "out of range" in text and not refusal(node, "a", 8)
    raised(InvalidParameterValueException, node.set_descriptor, "a", small, 6)
    assert node.set_descriptor("a", small, 4).integer_value == 4
    assert "out of range" in refusal(node, "a", 6) and not refusal(node, "a", 5)
    alternative = Parameter("x", value=1).get_parameter_value()
    assert node.set_descriptor("a", ParameterDescriptor(), alternative).integer_value == 5


# --- setting ----------------------------------------------------------------------------------


def test_all_or_none() -> None:
    node = fresh("a", 1)
    node.declare_parameter("b", "x")
    both = [Parameter("a", value=2), Parameter("b", value=2)]
    result = node.set_parameters_atomically(both)
    assert not result.successful and "expected STRING" in result.reason
    assert node.get_parameter("a").value == 1
    results = node.set_parameters(both)
    assert [result.successful for result in results] == [True, False]
    assert node.get_parameter("a").value == 2
    assert node.set_parameters_atomically([Parameter("a", value=3)]).successful


def test_callbacks_accept_or_refuse_and_are_called_afterwards() -> None:
    node = fresh("a", 1)
    calls = []

    def first(parameters):
        calls.append(("first", [parameter.value for parameter in parameters]))
        return SetParametersResult(successful=parameters[0].value < 5, reason="too much")

    def second(parameters):
        calls.append("second")
        return SetParametersResult(successful=True)

    def after(parameters):
        calls.append(("after", node.get_parameter("a").value))

    node.add_on_set_parameters_callback(first)
    node.add_on_set_parameters_callback(second)
    node.add_post_set_parameters_callback(after)
    assert refusal(node, "a", 5) == "too much"
    assert calls == ["second", ("first", [5])] and node.get_parameter("a").value == 1
    calls.clear()
    assert not refusal(node, "a", 4)
    assert calls == ["second", ("first", [4]), ("after", 4)]
    calls.clear()
    node.declare_parameter("b", 0)
    assert calls == ["second", ("first", [0]), ("after", 4)]
    raised(InvalidParameterValueException, node.declare_parameter, "c", 9)
    node.remove_on_set_parameters_callback(first)
    node.remove_on_set_parameters_callback(second)
    node.remove_post_set_parameters_callback(after)
    calls.clear()
    assert not refusal(node, "a", 9) and calls == []
    node.add_on_set_parameters_callback(lambda parameters: None)
    assert "no SetParametersResult" in refusal(node, "a", 1)


def test_a_pre_set_callback_may_change_the_parameters() -> None:
    node = fresh("a", 1)
    node.declare_parameter("b", 1)

    def both(parameters):
        return parameters + [Parameter("b", value=parameter.value * 2) for parameter in parameters]

    node.add_pre_set_parameters_callback(both)
    assert not refusal(node, "a", 5) and node.get_parameter("b").value == 10
    node.remove_pre_set_parameters_callback(both)
    node.add_pre_set_parameters_callback(lambda parameters: [])
    assert "left no parameter" in refusal(node, "a", 6)


# --- the services -----------------------------------------------------------------------------


def test_get_set_and_their_types_over_the_wire() -> None:
    bench = declared()
    names = ["p%d" % kind for kind in range(1, 10)]
    (values,) = bench.ask(GET, [names])
    assert values == [wire("x", kind, VALUES[kind])[1:] for kind in range(1, 10)]
    assert bench.ask(NODE + "/get_parameter_types", [names]) == [bytes(range(1, 10))]
    new = (None, False, 2**63 - 1, -1e-300, "", b"", [], [0], [-0.5], ["x" * 300])
    asked = [wire("p%d" % kind, kind, new[kind]) for kind in range(1, 10)]
    assert bench.ask(SET, [asked]) == [[[True, ""]] * 9]
    assert bench.ask(GET, [names])[0] == [parameter[1:] for parameter in asked]
    assert [bench.node.get_parameter(name).value for name in names] == list(new[1:])


def test_unknown_names_over_the_wire() -> None:
    bench = declared()
    assert bench.ask(GET, [["p1", "none"]]) == [[]]
    assert bench.ask(NODE + "/get_parameter_types", [["p1", "none"]]) == [b""]
    assert bench.ask(NODE + "/describe_parameters", [["p1", "none"]]) == [[]]
    ((first, second),) = bench.ask(SET, [[wire("none", 2, 1), wire("p2", 2, 8)]])
    assert first == [False, "none is not declared"] and second == [True, ""]
    assert bench.ask(GET, [[]]) == [[]] and bench.ask(SET, [[]]) == [[]]


def test_a_type_without_a_value_over_the_wire() -> None:
    bench = declared()
    bench.node.declare_parameter("q", Type.INTEGER)
    bench.node.declare_parameter("r", None, ParameterDescriptor(dynamic_typing=True))
    assert bench.ask(GET, [["p1", "q"]]) == [[]]
    assert bench.ask(GET, [["r"]]) == [[wire("r", 0, None)[1:]]]
    assert bench.ask(NODE + "/get_parameter_types", [["q", "r"]]) == [b"\x00\x00"]


def test_refusals_over_the_wire_have_a_reason() -> None:
    bench = declared()
    bench.node.declare_parameter("q", 1, ParameterDescriptor(read_only=True))
    for message, expected in (
        (wire("p2", 3, 1.0), "p2: wrong type, expected INTEGER, got DOUBLE"),
        (wire("p2", 0, None), "static type"),
        (wire("q", 2, 2), "q is read-only"),
        (wire("p2", 10, None), "p2: there is no type 10"),
        (wire("p2", 255, None), "p2: there is no type 255"),
    ):
        (((successful, reason),),) = bench.ask(SET, [[message]])
        assert not successful and expected in reason, reason
        assert not bench.errors
    assert bench.node.get_parameter("p2").value == -5


def test_all_or_none_over_the_wire() -> None:
    bench = declared()
    name = NODE + "/set_parameters_atomically"
    successful, reason = bench.ask(name, [[wire("p2", 2, 6), wire("p3", 2, 6)]])
    assert not successful and "expected DOUBLE" in reason
    successful, reason = bench.ask(name, [[wire("p2", 2, 6), wire("none", 2, 6)]])
    assert not successful and "none is not declared" in reason
    assert bench.node.get_parameter("p2").value == -5
    assert bench.ask(name, [[wire("p2", 2, 6), wire("p3", 3, 6.0)]]) == [True, ""]
    assert bench.node.get_parameter("p3").value == 6.0


def test_a_callback_that_raises_refuses_the_parameters() -> None:
    bench = declared()

    def bad(parameters):
        raise RuntimeError("motor on fire")

    bench.node.add_on_set_parameters_callback(bad)
    (((successful, reason),),) = bench.ask(SET, [[wire("p2", 2, 6)]])
    assert not successful and "motor on fire" in reason
    assert [str(error) for error in bench.errors] == ["motor on fire"]
    bench.node.remove_on_set_parameters_callback(bad)
    assert bench.ask(SET, [[wire("p2", 2, 6)]]) == [[[True, ""]]]


def test_describe_over_the_wire() -> None:
    bench = declared()
    node = bench.node
    node.declare_parameter(
        "i", 4,
        ParameterDescriptor(
            description="an int", additional_constraints="even", read_only=True,
            integer_range=[IntegerRange(-4, 8, 2)],
        ),
    )  # fmt: skip
    limits = [FloatingPointRange(0.0, 1.0, 0.25)]
    node.declare_parameter(
        "f", 0.5, ParameterDescriptor(dynamic_typing=True, floating_point_range=limits)
    )
    assert bench.ask(NODE + "/describe_parameters", [["i", "p9", "f"]]) == [
        [
            ["i", 2, "an int", "even", True, False, [], [[-4, 8, 2]]],
            ["p9", 9, "", "", False, False, [], []],
            ["f", 3, "", "", False, True, [[0.0, 1.0, 0.25]], []],
        ]
    ]


def test_list_over_the_wire() -> None:
    bench = Bench(connect=False)
    for name in ("a", "b.c", "b.d.e", "b.d.f", "bb", "z.y.x.w"):
        bench.node.declare_parameter(name, 1)
    bench.connect()
    everything = ["a", "b.c", "b.d.e", "b.d.f", "bb", "z.y.x.w"]
    for prefixes, depth, names, expected_prefixes in (
        ([], 0, everything, ["b", "b.d", "z.y.x"]),
        ([], 1, ["a", "bb"], []),
        ([], 2, ["a", "b.c", "bb"], ["b"]),
        (["b"], 0, ["b.c", "b.d.e", "b.d.f"], ["b", "b.d"]),
        (["b"], 1, ["b.c"], ["b"]),
        (["b.d"], 1, ["b.d.e", "b.d.f"], ["b.d"]),
        (["b", "a"], 2, ["a", "b.c", "b.d.e", "b.d.f"], ["b", "b.d"]),
        (["z"], 3, ["z.y.x.w"], ["z.y.x"]),
        (["z"], 2, [], []),
        (["none"], 0, [], []),
    ):
        result = bench.ask(NODE + "/list_parameters", [prefixes, depth])
        assert result == [names, expected_prefixes], (prefixes, depth, result)
    result = bench.node.list_parameters(["bb"], 0)
    assert result.names == ["bb"] and result.prefixes == []


def test_changes_are_published() -> None:
    bench = declared()
    node = bench.node
    node.declare_parameter("new", 1)
    node.set_parameters_atomically([Parameter("new", value=2), Parameter("p4", value="x")])
    node.set_parameters([Parameter("p2", value="wrong"), Parameter("p1", value=False)])
    node.declare_parameter("gone", None, ParameterDescriptor(dynamic_typing=True))
    node.set_parameters([Parameter("gone", value=1)])
    node.set_parameters([Parameter("gone")])
    heard = bench.heard(EVENTS)
    assert [message[2] for message in heard] == [NODE] * 6
    assert all([message[0] >= 1700000000 for message in heard])
    assert [message[3:] for message in heard] == [
        [[wire("new", 2, 1)], [], []],
        [[], [wire("new", 2, 2), wire("p4", 4, "x")], []],
        [[], [wire("p1", 1, False)], []],
        [[wire("gone", 0, None)], [], []],
        [[wire("gone", 2, 1)], [], []],
        [[], [], [wire("gone", 0, None)]],
    ]
    bench.ask(SET, [[wire("p2", 2, 1)]])
    assert [message[3:] for message in bench.heard(EVENTS)] == [[[], [wire("p2", 2, 1)], []]]


def test_events_can_be_switched_off() -> None:
    bench = declared(events=False)
    assert not [entity for entity in bench.node._entities if getattr(entity, "name", "") == EVENTS]
    assert bench.ask(SET, [[wire("p2", 2, 1)]]) == [[[True, ""]]]


def test_the_values_outlive_the_agent() -> None:
    bench = declared()
    bench.ask(SET, [[wire("p2", 2, 99)]])
    bench.lose()
    bench.node.set_parameters([Parameter("p1", value=False)])  # without an agent
    bench.connect()
    (values,) = bench.ask(GET, [["p1", "p2"]])
    assert [values[0][1], values[1][2]] == [False, 99]


def test_malformed_requests_of_parameters_are_counted() -> None:
    bench = declared()
    service = bench.entity(SET)
    for octets in (b"", b"\xff" * 40, b"\xff\xff\xff\x7f"):
        bench.agent.sample(service.number << 4 | 0x8, bytes(24) + octets)
        bench.run(50)
    assert service.malformed == 3
    assert bench.ask(SET, [[wire("p2", 2, 1)]]) == [[[True, ""]]]
