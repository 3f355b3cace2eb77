"""Parameter: name, type, value and constraints; see :mod:`~uros.client.parameters`."""

import sys

try:
    from typing import Any, Final
except ImportError:  # MicroPython
    pass

# Whether these classes have __repr__, which would cost memory on a board.
TELLING = sys.implementation.name != "micropython"

_LOWEST: Final = -9223372036854775808
_HIGHEST: Final = 9223372036854775807
# Relative tolerance between a float and a bound or a step of its range.
_NEAR: Final = 0.000001


class ParameterException(Exception):
    """Base class of the exceptions for parameters.

    ::

        Exception
        └── ParameterException
            ├── ParameterNotDeclaredException
            ├── ParameterAlreadyDeclaredException
            ├── ParameterImmutableException     it is read-only
            ├── ParameterUninitializedException its type is known, its value is not
            ├── InvalidParameterException       a name that none can have
            └── InvalidParameterValueException
                └── InvalidParameterTypeException
    """


class ParameterNotDeclaredException(ParameterException):
    """The parameter is not declared."""

    pass


class ParameterAlreadyDeclaredException(ParameterException):
    """The parameter is declared already."""

    pass


class ParameterImmutableException(ParameterException):
    """The parameter is read-only."""

    pass


class ParameterUninitializedException(ParameterException):
    """The parameter has a type but no value yet."""

    pass


class InvalidParameterException(ParameterException):
    """The parameter's name is not allowed."""

    pass


class InvalidParameterValueException(ParameterException):
    """The value is out of range or refused by a callback."""

    pass


class InvalidParameterTypeException(InvalidParameterValueException):
    """The value is of another type than the parameter."""

    pass


class Kind(int):
    """A number of :class:`ParameterType`."""

    @property
    def value(self) -> int:
        """The number as an int."""
        return self + 0

    @property
    def name(self) -> str:
        """The name of the type, as ``INTEGER`` for 2."""
        return kind_name(self)


class ParameterType:
    """``Parameter.Type``: the types of parameters, numbered as in rcl_interfaces."""

    NOT_SET = Kind(0)
    BOOL = Kind(1)
    INTEGER = Kind(2)
    DOUBLE = Kind(3)
    STRING = Kind(4)
    BYTE_ARRAY = Kind(5)
    BOOL_ARRAY = Kind(6)
    INTEGER_ARRAY = Kind(7)
    DOUBLE_ARRAY = Kind(8)
    STRING_ARRAY = Kind(9)


_NAMES = (
    "NOT_SET BOOL INTEGER DOUBLE STRING"
    " BYTE_ARRAY BOOL_ARRAY INTEGER_ARRAY DOUBLE_ARRAY STRING_ARRAY"
)


def kind_name(kind: int) -> str:
    """Return the name of a type, ``INTEGER`` for 2."""
    return _NAMES.split(" ")[kind]


class Parameter:
    """A name, a type and a value; ``kind`` is the type as a number.

    Args:
        name: The name.
        type_: The type; by default that of the value.
        value: The value.

    Raises:
        TypeError: No parameter can have this value.
        ValueError: The value is not of the type.
    """

    Type = ParameterType

    def __init__(self, name: str, type_: "int | None" = None, value: "Any" = None) -> None:
        self.name = name
        self.kind = kind_of(value) if type_ is None else type_ + 0
        self.value = fit(value, self.kind)

    @property
    def type_(self) -> Kind:
        """The type."""
        return Kind(self.kind)

    @classmethod
    def from_parameter_msg(cls, message: "Any") -> "Parameter":
        """Return the parameter of a ``rcl_interfaces/msg/Parameter``."""
        kind = message.value.type
        value = getattr(message.value, kind_name(kind).lower() + "_value") if kind else None
        return cls(message.name, kind, value)

    def get_parameter_value(self) -> "ParameterValue":
        """Return the value as a message: ``.integer_value`` and so on."""
        return ParameterValue(self.kind, self.value)

    if TELLING:

        def __repr__(self) -> str:
            return "Parameter(%r, %s, %r)" % (self.name, kind_name(self.kind), self.value)


class ParameterValue:
    """Has the fields of ``rcl_interfaces/msg/ParameterValue``: ``type``, and one for each type."""

    def __init__(self, kind: int, value: "Any") -> None:
        self.type = kind
        nothing: "Any" = (None, False, 0, 0.0, "", b"", [], [], [], [])
        for number in range(1, len(nothing)):
            name = kind_name(number).lower() + "_value"
            setattr(self, name, value if number == kind else nothing[number])


class IntegerRange:
    """Range from ``from_value`` to ``to_value``, both included, in steps of ``step`` (0: any)."""

    def __init__(self, from_value: "Any" = 0, to_value: "Any" = 0, step: "Any" = 0) -> None:
        self.from_value = from_value
        self.to_value = to_value
        self.step = step


class FloatingPointRange(IntegerRange):
    """Range of floats; see :class:`IntegerRange`."""


class ParameterDescriptor:
    """Description and constraints of a parameter; each list of ranges has at most one item."""

    def __init__(
        self, name: str = "", type: int = 0, description: str = "",
        additional_constraints: str = "", read_only: bool = False, dynamic_typing: bool = False,
        floating_point_range: "Any" = (), integer_range: "Any" = (),
    ) -> None:  # fmt: skip
        self.name = name
        self.type = type
        self.description = description
        self.additional_constraints = additional_constraints
        self.read_only = read_only
        self.dynamic_typing = dynamic_typing
        self.floating_point_range = floating_point_range
        self.integer_range = integer_range


class SetParametersResult:
    """Whether setting parameters succeeded, and if not, why."""

    def __init__(self, successful: bool = True, reason: str = "") -> None:
        self.successful = successful
        self.reason = reason

    if TELLING:

        def __repr__(self) -> str:
            return "SetParametersResult(%r, %r)" % (self.successful, self.reason)


class ListParametersResult:
    """Names of parameters, and the prefixes of these names."""

    def __init__(self, names: "list[str]", prefixes: "list[str]") -> None:
        self.names = names
        self.prefixes = prefixes


def kind_of(value: "Any") -> int:
    """Return the type of a value; an empty list is one of bytes, as in rclpy.

    Raises:
        TypeError: No parameter can have this value.
    """
    if value is None:
        return 0
    if isinstance(value, bool):  # first: on CPython a bool is an int, too
        return 1
    if isinstance(value, int):
        return 2
    if isinstance(value, float):
        return 3
    if isinstance(value, str):
        return 4
    if isinstance(value, (bytes, bytearray)):
        return 5
    kind = 0
    if not isinstance(value, (dict, set)):
        try:
            items = list(value)
            kind = 5
            if items and not isinstance(items[0], bytes):
                kind += kind_of(items[0])
                if not 5 < kind <= 9:
                    kind = 0
        except TypeError:
            kind = 0
    if not kind:
        raise TypeError(
            "%r: a parameter is a bool, int, float, str, bytes, or a list of the first four"
            % (value,)
        )
    return kind


def fit(value: "Any", kind: int) -> "Any":
    """Return the value as a parameter of this type keeps it.

    Raises:
        ValueError: The value is not of the type.
    """
    if 0 <= kind <= 4:
        if kind == 4 and isinstance(value, str):
            value.encode()  # raises ValueError if UTF-8 cannot encode it
        elif kind == 2 and isinstance(value, int) and not _LOWEST <= value <= _HIGHEST:
            raise ValueError("%d does not fit 64 bits" % value)
        if kind_of(value) == kind:
            return value
    elif kind == 5 and isinstance(value, (bytes, bytearray)):
        return bytes(value)
    elif 5 <= kind <= 9 and not isinstance(value, (str, bytes, bytearray, dict, set)):
        try:
            items = list(value)
        except TypeError:
            items = [None]
        if kind > 5:
            return [fit(item, kind - 5) for item in items]
        if all([isinstance(item, bytes) and len(item) == 1 for item in items]):
            return b"".join(items)
    raise ValueError("%r is no %s" % (value, kind_name(kind) if 0 <= kind <= 9 else kind))


def near(a: float, b: float) -> bool:
    """Return whether two floats are equal within the tolerance."""
    return a == b or abs(a - b) <= _NEAR * min(abs(a), abs(b))


def outside(parameter: Parameter, limits: "Any") -> str:
    """Return why the value is not in the range, or "" if it is."""
    low = min(limits.from_value, limits.to_value)
    high = max(limits.from_value, limits.to_value)
    value, step, fault = parameter.value, limits.step, ""
    if parameter.kind == 2:
        if not low <= value <= high:
            fault = "out of range"
        elif step and value != high and (value - low) % step:
            fault = "no step of its range"
    elif not (near(value, low) or near(value, high)):
        if not low < value < high:
            fault = "out of range"
        elif step:
            count = (value - low) / step
            # From 1e15 on the rounding below is not exact, so any value counts as a step.
            if abs(count) < 1e15 and not near(low + int(count + 0.5) * step, value):
                fault = "no step of its range"
    if not fault:
        return ""
    text = "%s: %s is %s, %s to %s" % (parameter.name, value, fault, low, high)
    return text + (" by %s" % step if step else "")
