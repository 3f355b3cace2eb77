"""The six parameter services of a node, and ``/parameter_events``."""

from .dynamic_messages import Shape, ShapedService
from .parameter import Parameter, ParameterException, SetParametersResult

try:
    from typing import Any
except ImportError:  # MicroPython
    pass

# rcl_interfaces: Parameter, ParameterDescriptor.
_VALUE = "B?qds[B][?][q][d][s]"
_PARAMETERS = "[s" + _VALUE + "]"
_DESCRIPTORS = "[sBss??[ddd][qqQ]]"
# Depth of rmw_qos_profile_parameter_events, so that slow readers get bursts of events.
_EVENTS = 1000


class ParameterServices:
    """Parameter services of a :class:`~uros.client.parameters.ParameterServer`.

    Args:
        server: The parameter server.
        events: Whether to publish ``/parameter_events``.
    """

    def __init__(self, server: "Any", events: bool) -> None:
        self._server = server
        node = server.node
        for name, request, response, callback in (
            ("DescribeParameters", "[s]", _DESCRIPTORS, self._describe),
            ("GetParameters", "[s]", "[" + _VALUE + "]", self._get),
            ("GetParameterTypes", "[s]", "[B]", self._types),
            ("ListParameters", "[s]Q", "[s][s]", self._list),
            ("SetParameters", _PARAMETERS, "[?s]", self._set),
            ("SetParametersAtomically", _PARAMETERS, "?s", self._set_atomically),
        ):
            type_name = "rcl_interfaces/srv/" + name
            node.create_service(
                ShapedService(type_name, request, response), "~/" + _snake(name), callback
            )
        self._events: "Any" = None
        if events:
            shape = Shape("rcl_interfaces/msg/ParameterEvent", "iIs" + 3 * _PARAMETERS)
            self._events = node.create_publisher(shape, "/parameter_events", _EVENTS)

    def tell(
        self, new: "list[Parameter]", changed: "list[Parameter]", deleted: "list[Parameter]"
    ) -> None:
        """Publish new, changed and deleted parameters on ``/parameter_events``."""
        if self._events is None or not self._events.created:
            return
        node = self._server.node
        lists = [[_message(parameter) for parameter in part] for part in (new, changed, deleted)]
        try:
            self._events.publish(
                self._events.type(
                    list(node.clock.now()) + [node.get_fully_qualified_name()] + lists
                )
            )
        except Exception as error:  # the event is too long; the parameters are set already
            node.executor.report(error)

    def _describe(self, request: "Any", response: "Any") -> "Any":
        server = self._server
        response.values = [[]]
        try:
            for name in request.values[0]:
                descriptor = server.describe_parameter(name)
                ranges = [
                    [[limits.from_value, limits.to_value, limits.step] for limits in part]
                    for part in (descriptor.floating_point_range, descriptor.integer_range)
                ]
                response.values[0].append(
                    [
                        descriptor.name, descriptor.type, descriptor.description,
                        descriptor.additional_constraints, descriptor.read_only,
                        descriptor.dynamic_typing,
                    ]
                    + ranges
                )  # fmt: skip
        except ParameterException:
            response.values = [[]]  # all or nothing, as rclpy
        return response

    def _get(self, request: "Any", response: "Any") -> "Any":
        try:
            parameters = self._server.get_parameters(request.values[0])
            response.values = [[_message(parameter)[1:] for parameter in parameters]]
        except ParameterException:
            response.values = [[]]
        return response

    def _types(self, request: "Any", response: "Any") -> "Any":
        try:
            response.values = [bytes(self._server.get_parameter_types(request.values[0]))]
        except ParameterException:
            response.values = [b""]
        return response

    def _list(self, request: "Any", response: "Any") -> "Any":
        result = self._server.list_parameters(request.values[0], request.values[1])
        response.values = [result.names, result.prefixes]
        return response

    def _set(self, request: "Any", response: "Any") -> "Any":
        response.values = [[self._try([values]) for values in request.values[0]]]
        return response

    def _set_atomically(self, request: "Any", response: "Any") -> "Any":
        response.values = self._try(request.values[0])
        return response

    def _try(self, messages: "list[Any]") -> "list[Any]":
        """Set all of the parameters or none; return [successful, reason]."""
        try:
            result = self._server.set_parameters_atomically(
                [_parameter(values) for values in messages]
            )
        except ParameterException as error:
            result = SetParametersResult(False, str(error))
        except Exception as error:
            # A callback of the program raised; the caller of the service gets the reason.
            self._server.node.executor.report(error)
            result = SetParametersResult(False, "a callback raised %r" % (error,))
        return [result.successful, result.reason]


def _snake(name: str) -> str:
    """Return a name in snake case, ``get_parameters`` for ``GetParameters``."""
    out = ""
    for char in name:
        out += "_" + char.lower() if "A" <= char <= "Z" else char
    return out[1:]


def _message(parameter: Parameter) -> "list[Any]":
    """Return the values of a Parameter message in the order of _PARAMETERS."""
    values: "list[Any]" = [parameter.name, parameter.kind, False, 0, 0.0, "", b"", [], [], [], []]
    if parameter.kind:
        values[parameter.kind + 1] = parameter.value
    return values


def _parameter(values: "list[Any]") -> Parameter:
    kind = values[1]
    if kind > 9:
        raise ParameterException("%s: there is no type %d" % (values[0], kind))
    return Parameter(values[0], kind, values[kind + 1] if kind else None)
