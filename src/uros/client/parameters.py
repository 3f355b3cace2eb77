"""Parameters of a node, as in rclpy: named values that other nodes can read and set.

``node.declare_parameter("rate", 10)`` creates the node's :class:`ParameterServer`, with the six
services that ``ros2 param`` uses; it publishes changes on ``/parameter_events``. To set options of
the server, create it before the first parameter is declared::

    ParameterServer(node, persist=ParameterFile("params.json"))

Values are bool, int (64 bits), float, str, bytes, and lists of the first four. Descriptors and
results are the classes of this module; messages of ``rcl_interfaces.msg`` are accepted, too.
"""

from .parameter import (
    FloatingPointRange,
    IntegerRange,
    InvalidParameterException,
    InvalidParameterTypeException,
    InvalidParameterValueException,
    Kind,
    ListParametersResult,
    Parameter,
    ParameterAlreadyDeclaredException,
    ParameterDescriptor,
    ParameterException,
    ParameterImmutableException,
    ParameterNotDeclaredException,
    ParameterType,
    ParameterUninitializedException,
    ParameterValue,
    SetParametersResult,
    kind_name,
    outside,
)
from .parameter_services import ParameterServices

try:
    from typing import Any, Callable, Iterable
except ImportError:  # MicroPython
    pass

__all__ = [
    "FloatingPointRange", "IntegerRange", "InvalidParameterException",
    "InvalidParameterTypeException", "InvalidParameterValueException", "ListParametersResult",
    "Parameter", "ParameterAlreadyDeclaredException", "ParameterDescriptor", "ParameterException",
    "ParameterImmutableException", "ParameterNotDeclaredException", "ParameterServer",
    "ParameterType", "ParameterUninitializedException", "ParameterValue", "SetParametersResult",
]  # fmt: skip


class ParameterServer:
    """Parameters of a node and their services; the methods are those of rclpy's Node.

    Args:
        node: The node.
        persist: A :class:`~uros.client.parameter_file.ParameterFile` that keeps the values that
            were set. They take precedence over all others.
        overrides: Values by name that take precedence over declared ones.
        allow_undeclared: Whether other nodes may set parameters that are not declared.
        events: Whether changes are published on ``/parameter_events``.

    Raises:
        ValueError: The node has a parameter server already.
    """

    def __init__(
        self, node: "Any", persist: "Any" = None, overrides: "dict[str, Any] | None" = None,
        allow_undeclared: bool = False, events: bool = True,
    ) -> None:  # fmt: skip
        if node._parameters is not None:
            raise ValueError("%s has parameters already: make the server first" % node.name)
        node._parameters = self
        self.node = node
        self.allow_undeclared = allow_undeclared
        self._parameters: "dict[str, Parameter]" = {}
        # Descriptors by name; None: static type, without other constraints.
        self._rules: "dict[str, Any]" = {}
        self._overrides = overrides or {}
        self._before: "list[Any]" = []
        self._on: "list[Any]" = []
        self._after: "list[Any]" = []
        self._services = ParameterServices(self, events)
        self._file = persist
        if persist is not None:
            persist.open(node)

    # --- declaring ----------------------------------------------------------------------------

    def declare_parameter(
        self, name: str, value: "Any" = None, descriptor: "Any" = None,
        ignore_override: bool = False,
    ) -> Parameter:  # fmt: skip
        """Declare a parameter with its default value, or with its type alone (``Parameter.Type``).

        Raises:
            ParameterException: One of its subclasses, which says why.
            TypeError: No parameter can have this value.
            ValueError: The type and ``dynamic_typing`` of the descriptor contradict the value.
        """
        if not name or not isinstance(name, str):
            raise InvalidParameterException("%r: a parameter's name is a text" % (name,))
        if name in self._parameters:
            raise ParameterAlreadyDeclaredException(name + " is declared already")
        dynamic = bool(descriptor is not None and descriptor.dynamic_typing)
        if isinstance(value, Kind):
            if dynamic or not value + 0:
                raise ValueError(name + ": a type given is a static one, and not NOT_SET")
            descriptor = _own(descriptor or ParameterDescriptor(), name, value + 0)
            parameter = Parameter(name)
        else:
            parameter = Parameter(name, None, value)
            if value is None and not dynamic:
                if descriptor is not None:
                    raise ValueError(name + ": give a value, a Parameter.Type, or dynamic_typing")
                descriptor = ParameterDescriptor(dynamic_typing=True)
            if descriptor is not None:
                descriptor = _own(descriptor, name, parameter.kind)
        rules = {name: descriptor}
        kind = descriptor.type if descriptor is not None else parameter.kind
        saved = False
        if not ignore_override:
            if name in self._overrides:
                parameter = Parameter(name, None, self._overrides[name])
            if self._file is not None and name in self._file.values:
                saved = True
                default = parameter
                parameter = self._file.values[name]
        result = self._commit([parameter], rules, kind)
        if saved and not result.successful:
            self._file.refused(name, result.reason)
            result = self._commit([default], rules, kind)
        if not result.successful:
            fault = InvalidParameterValueException
            if parameter.kind != kind:
                fault = InvalidParameterTypeException
            raise fault(result.reason)
        return self._parameters[name]

    def declare_parameters(
        self, namespace: str, parameters: "Iterable[tuple[Any, ...]]",
        ignore_override: bool = False,
    ) -> "list[Parameter]":  # fmt: skip
        """Declare parameters, each given as (name), (name, value) or (name, value, descriptor).

        ``namespace`` and a dot are put before each name, unless it is empty.
        """
        out = []
        for declaration in parameters:
            name = namespace + "." + declaration[0] if namespace else declaration[0]
            value = declaration[1] if len(declaration) > 1 else None
            descriptor = declaration[2] if len(declaration) > 2 else None
            out.append(self.declare_parameter(name, value, descriptor, ignore_override))
        return out

    def undeclare_parameter(self, name: str) -> None:
        """Remove a parameter that is not read-only."""
        self._known(name)
        rule = self._rules[name]
        if rule is not None and rule.read_only:
            raise ParameterImmutableException(name + " is read-only")
        self._drop(name)

    def has_parameter(self, name: str) -> bool:
        """Return whether a parameter is declared."""
        return name in self._parameters

    # --- reading ------------------------------------------------------------------------------

    def get_parameter(self, name: str) -> Parameter:
        """Return a parameter."""
        if name not in self._parameters and self.allow_undeclared:
            return Parameter(name)
        parameter = self._known(name)
        if not parameter.kind and not self._rules[name].dynamic_typing:
            raise ParameterUninitializedException(name + " has no value yet")
        return parameter

    def get_parameters(self, names: "Iterable[str]") -> "list[Parameter]":
        """Return several parameters."""
        return [self.get_parameter(name) for name in names]

    def get_parameter_or(
        self, name: str, alternative_value: "Parameter | None" = None
    ) -> Parameter:
        """Return the parameter, or the alternative if it has no value."""
        parameter = self._parameters.get(name)
        if parameter is None or not parameter.kind:
            return Parameter(name) if alternative_value is None else alternative_value
        return parameter

    def get_parameters_by_prefix(self, prefix: str) -> "dict[str, Parameter]":
        """Return the parameters named ``prefix`` and a dot and more, by the rest of the name."""
        start = prefix + "." if prefix else ""
        return {
            name[len(start) :]: self._parameters[name]
            for name in self._parameters
            if name.startswith(start)
        }

    def get_parameter_type(self, name: str) -> Kind:
        """Return the type of a parameter."""
        if name not in self._parameters and self.allow_undeclared:
            return ParameterType.NOT_SET
        return self._known(name).type_

    def get_parameter_types(self, names: "Iterable[str]") -> "list[Kind]":
        """Return the types of several parameters."""
        return [self.get_parameter_type(name) for name in names]

    def describe_parameter(self, name: str) -> "Any":
        """Return the descriptor of a parameter."""
        if name not in self._parameters and self.allow_undeclared:
            return ParameterDescriptor()
        parameter = self._known(name)
        rule = self._rules[name]
        return ParameterDescriptor(name, parameter.kind) if rule is None else rule

    def describe_parameters(self, names: "Iterable[str]") -> "list[Any]":
        """Return the descriptors of several parameters."""
        return [self.describe_parameter(name) for name in names]

    def list_parameters(self, prefixes: "list[str]", depth: int) -> ListParametersResult:
        """Return the sorted names of parameters below the prefixes, and their own prefixes.

        Args:
            prefixes: Prefixes of names; if empty, all names match.
            depth: Names have fewer than ``depth`` dots behind the prefix; 0: any number.
        """
        names: "list[str]" = []
        parents: "list[str]" = []
        for name in sorted(self._parameters):
            if not prefixes:
                if depth and name.count(".") >= depth:
                    continue
            elif not any([_below(name, prefix, depth) for prefix in prefixes]):
                continue
            names.append(name)
            dot = name.rfind(".")
            if dot >= 0 and name[:dot] not in parents:
                parents.append(name[:dot])
        return ListParametersResult(names, parents)

    # --- setting ------------------------------------------------------------------------------

    def set_parameters(self, parameter_list: "Iterable[Parameter]") -> "list[Any]":
        """Set parameters one by one; return a result for each."""
        return [self.set_parameters_atomically([parameter]) for parameter in parameter_list]

    def set_parameters_atomically(self, parameter_list: "list[Parameter]") -> "Any":
        """Set all of the parameters or none; return the result.

        Raises:
            ParameterNotDeclaredException: A parameter is not declared.
        """
        if self._before:
            changed: "list[Parameter]" = []
            for callback in self._before:
                changed.extend(callback(parameter_list))
            parameter_list = changed
            if not changed:
                return SetParametersResult(
                    False, "a pre_set_parameters callback has left no parameter to set"
                )
        if not self.allow_undeclared:
            for parameter in parameter_list:
                self._known(parameter.name)
        return self._commit(parameter_list, None, 0)

    def set_descriptor(
        self, name: str, descriptor: "Any", alternative_value: "Any" = None
    ) -> "Any":
        """Replace the descriptor of a parameter; return the parameter's value.

        Args:
            name: The parameter.
            descriptor: Its new constraints.
            alternative_value: A plain value, or a message as ParameterValue, which replaces a value
                that violates the constraints.
        """
        if name not in self._parameters and self.allow_undeclared:
            return Parameter(name).get_parameter_value()
        parameter = self._known(name)
        if self.describe_parameter(name).read_only:
            raise ParameterImmutableException(name + " is read-only")
        descriptor = _own(descriptor, name, descriptor.type or parameter.kind)
        fault = self._fault(parameter, descriptor, False)
        if fault and alternative_value is not None:
            if hasattr(alternative_value, "type"):
                kind = alternative_value.type
                alternative_value = getattr(alternative_value, kind_name(kind).lower() + "_value")
            parameter = Parameter(name, None, alternative_value)
            fault = self._fault(parameter, descriptor, False)
        if fault:
            raise InvalidParameterValueException(fault)
        if self._file is not None and parameter is not self._parameters[name]:
            self._file.changed(name, parameter)
        self._parameters[name] = parameter
        self._rules[name] = descriptor
        return self.get_parameter(name).get_parameter_value()

    def add_pre_set_parameters_callback(
        self, callback: "Callable[[list[Parameter]], list[Parameter]]"
    ) -> None:
        """Add a callback: ``callback(parameters)`` returns the parameters to set instead."""
        self._before.insert(0, callback)

    def add_on_set_parameters_callback(self, callback: "Callable[[list[Parameter]], Any]") -> None:
        """Add a callback: ``callback(parameters)`` returns a SetParametersResult.

        It must change nothing: a later callback may still refuse.
        """
        self._on.insert(0, callback)

    def add_post_set_parameters_callback(
        self, callback: "Callable[[list[Parameter]], object]"
    ) -> None:
        """Add a callback: ``callback(parameters)`` gets the parameters that were set."""
        self._after.insert(0, callback)

    def remove_pre_set_parameters_callback(self, callback: "Any") -> None:
        """Remove a callback added by :meth:`add_pre_set_parameters_callback`."""
        self._before.remove(callback)

    def remove_on_set_parameters_callback(self, callback: "Any") -> None:
        """Remove a callback added by :meth:`add_on_set_parameters_callback`."""
        self._on.remove(callback)

    def remove_post_set_parameters_callback(self, callback: "Any") -> None:
        """Remove a callback added by :meth:`add_post_set_parameters_callback`."""
        self._after.remove(callback)

    # --- checks and commit --------------------------------------------------------------------

    def _known(self, name: str) -> Parameter:
        if name not in self._parameters:
            raise ParameterNotDeclaredException("%s is not declared" % name)
        return self._parameters[name]

    def _drop(self, name: str) -> None:
        self._parameters.pop(name, None)
        self._rules.pop(name, None)
        if self._file is not None:
            self._file.changed(name, None)

    def _fault(self, parameter: Parameter, rule: "Any", setting: bool) -> str:
        """Return why the parameter violates the descriptor ``rule``, or "" if it does not."""
        name, kind = parameter.name, parameter.kind
        if rule is None:
            wanted = self._parameters[name].kind if name in self._parameters else kind
        else:
            if setting and rule.read_only:
                return name + " is read-only"
            wanted = kind if rule.dynamic_typing else rule.type
        if not kind and setting and wanted:
            return name + " has a static type, so it cannot be undeclared by setting it to nothing"
        if kind and kind != wanted:
            return "%s: wrong type, expected %s, got %s" % (
                name, kind_name(wanted), kind_name(kind),
            )  # fmt: skip
        if rule is not None:
            if kind == 2 and rule.integer_range:
                return outside(parameter, rule.integer_range[0])
            if kind == 3 and rule.floating_point_range:
                return outside(parameter, rule.floating_point_range[0])
        return ""

    def _commit(
        self, parameters: "list[Parameter]", rules: "dict[str, Any] | None", kind: int
    ) -> "Any":
        """Set all of the parameters or none; return a SetParametersResult.

        With ``rules``, their descriptors, the parameters are declared with the type ``kind``.
        """
        for parameter in parameters:
            name = parameter.name
            if rules is not None:
                fault = ""
                if rules[name] is None and parameter.kind != kind:
                    fault = "%s: wrong type, expected %s, got %s" % (
                        name, kind_name(kind), kind_name(parameter.kind),
                    )  # fmt: skip
                fault = fault or self._fault(parameter, rules[name], False)
            elif name in self._parameters:
                fault = self._fault(parameter, self._rules[name], True)
            else:
                fault = ""
            if fault:
                return SetParametersResult(False, fault)
        for callback in self._on:
            result = callback(parameters)
            if not hasattr(result, "successful"):
                result = SetParametersResult(False, "a callback returned no SetParametersResult")
            if not result.successful:
                return result
        new: "list[Parameter]" = []
        changed: "list[Parameter]" = []
        deleted: "list[Parameter]" = []
        for parameter in parameters:
            name = parameter.name
            if rules is None and not parameter.kind:
                deleted.append(parameter)
                self._drop(name)
                continue
            if rules is not None:
                self._rules[name] = rules[name]
            elif name not in self._rules:
                self._rules[name] = ParameterDescriptor(name, dynamic_typing=True)
            rule = self._rules[name]
            if rule is not None and rule.dynamic_typing:
                rule.type = parameter.kind
            known = self._parameters.get(name)
            (changed if known is not None and known.kind else new).append(parameter)
            self._parameters[name] = parameter
            if rules is None and self._file is not None:
                self._file.changed(name, parameter)
        self._services.tell(new, changed, deleted)
        for callback in self._after:
            callback(parameters)
        return SetParametersResult()


def _own(descriptor: "Any", name: str, kind: int) -> ParameterDescriptor:
    """Return a copy of a descriptor for the parameter ``name``."""
    return ParameterDescriptor(
        name, kind, descriptor.description, descriptor.additional_constraints,
        descriptor.read_only, descriptor.dynamic_typing,
        descriptor.floating_point_range, descriptor.integer_range,
    )  # fmt: skip


def _below(name: str, prefix: str, depth: int) -> bool:
    return name == prefix or (
        name.startswith(prefix + ".") and (not depth or name.count(".", len(prefix) + 1) < depth)
    )
