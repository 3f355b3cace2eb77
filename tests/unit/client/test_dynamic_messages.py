"""Messages described by letters, compared with generated classes and fed with any bytes."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from uros.client.dynamic_messages import Shape
from uros.client.parameter_services import _DESCRIPTORS, _PARAMETERS, _VALUE
from uros.interfaces import load

TEXT = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), max_size=8)
OCTET = st.integers(0, 255)
NUMBERS = {
    "?": st.booleans(),
    "B": OCTET,
    "i": st.integers(-(2**31), 2**31 - 1),
    "I": st.integers(0, 2**32 - 1),
    "q": st.integers(-(2**63), 2**63 - 1),
    "Q": st.integers(0, 2**64 - 1),
    "d": st.floats(allow_nan=False),
    "s": TEXT,
}


def parts(letters):
    """Yield the letters of each field, a sequence with its content."""
    at = 0
    while at < len(letters):
        if letters[at] != "[":
            yield letters[at]
            at += 1
            continue
        depth, start = 1, at
        while depth:
            at += 1
            depth += {"[": 1, "]": -1}.get(letters[at], 0)
        at += 1
        yield letters[start:at]


def values_of(letters):
    return st.tuples(*map(value_of, parts(letters))).map(list)


def value_of(part):
    if part == "[B]":
        return st.binary(max_size=9)
    if len(part) > 1:
        inner = part[1:-1]
        item = value_of(inner) if len(inner) == 1 else values_of(inner)
        return st.lists(item, max_size=3)
    return NUMBERS[part]


# The types for which the client has no classes.
TYPES = {
    "rcl_interfaces/msg/ParameterValue": _VALUE,
    "rcl_interfaces/msg/ParameterEvent": "iIs" + 3 * _PARAMETERS,
    "rcl_interfaces/srv/DescribeParameters_Request": "[s]",
    "rcl_interfaces/srv/DescribeParameters_Response": _DESCRIPTORS,
    "rcl_interfaces/srv/GetParameters_Response": "[" + _VALUE + "]",
    "rcl_interfaces/srv/GetParameterTypes_Response": "[B]",
    "rcl_interfaces/srv/ListParameters_Request": "[s]Q",
    "rcl_interfaces/srv/ListParameters_Response": "[s][s]",
    "rcl_interfaces/srv/SetParameters_Request": _PARAMETERS,
    "rcl_interfaces/srv/SetParameters_Response": "[?s]",
    "rcl_interfaces/srv/SetParametersAtomically_Request": _PARAMETERS,
    "rcl_interfaces/srv/SetParametersAtomically_Response": "?s",
    "rcl_interfaces/srv/GetLoggerLevels_Response": "[sI]",
    "rcl_interfaces/srv/SetLoggerLevels_Request": "[sI]",
    "rcl_interfaces/srv/SetLoggerLevels_Response": "[?s]",
    "rcl_interfaces/msg/Log": "iIBssssI",
    "lifecycle_msgs/srv/ChangeState_Request": "Bs",
    "lifecycle_msgs/srv/ChangeState_Response": "?",
    "lifecycle_msgs/srv/GetState_Response": "Bs",
    "lifecycle_msgs/srv/GetAvailableStates_Response": "[Bs]",
    "lifecycle_msgs/srv/GetAvailableTransitions_Response": "[BsBsBs]",
    "lifecycle_msgs/msg/TransitionEvent": "QBsBsBs",
}


@pytest.mark.parametrize("name", TYPES)
def test_the_bytes_are_those_of_the_generated_class(name):
    cls = load(name)
    shape = Shape(name, TYPES[name])
    assert cls._DDS_TYPE == shape._DDS_TYPE

    @given(values_of(TYPES[name]))
    def check(values):
        if name.endswith("DescribeParameters_Response"):
            for value in values[0]:  # bounded by the type; letters have no bounds
                del value[6][1:], value[7][1:]
        octets = bytearray(shape(values).cdr_size())
        assert shape(values).pack_into(octets, 0, 0) == len(octets)
        message, end = cls.unpack_from(octets, 0, 0, len(octets))
        assert end == len(octets)
        again = bytearray(message.cdr_size())
        message.pack_into(again, 0, 0)
        assert again == octets
        back, end = shape.unpack_from(octets, 0, 0, len(octets))
        assert (back.values, end) == (values, len(octets))

    check()


@given(st.sampled_from(sorted(TYPES)), st.binary(max_size=200), st.booleans())
def test_any_bytes_are_decoded_or_refused(name, octets, little):
    try:
        _, end = Shape(name, TYPES[name]).unpack_from(octets, 0, 0, len(octets), little)
    except ValueError:
        return
    assert end <= len(octets)
