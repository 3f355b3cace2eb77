"""The node whose parameters a command reads or sets, and its parameter services."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from ...client.parameter import ParameterType
from ...printable import printable
from ..common import ANSWER_SECONDS, discover
from ..errors import ToolError, did_you_mean
from ..service.client import Call, ServiceClient, call_all
from ..waiting import find_node
from .values import Typed, as_declared, from_message, to_message, type_name

if TYPE_CHECKING:
    from ...host.network import Network

# Declared types whose values were written without a point, as values of the second type.
_WITHOUT_POINT: Final = (
    (ParameterType.DOUBLE, ParameterType.INTEGER),
    (ParameterType.DOUBLE_ARRAY, ParameterType.INTEGER_ARRAY),
)


class Result(NamedTuple):
    """What a node says of a parameter that was to be set."""

    name: str
    successful: bool
    reason: str


class ParameterNode:
    """The parameter services of a node.

    Args:
        network: The domain.
        name: The node's full name.
        seconds: The timeout of each call; None for the default.

    The methods raise ToolError if the node does not answer.
    """

    def __init__(self, network: Network, name: str, seconds: float | None) -> None:
        self.name = name
        self._network = network
        self._seconds = seconds or ANSWER_SECONDS

    def _call(self, kind: str, service: str, **request: Any) -> Any:
        call = _call(self.name, kind, service, **request)
        client = ServiceClient(self._network, call.service, call.kind)
        try:
            client.match(self._seconds)
            return client.answer(client.request(call.request), self._seconds)
        finally:
            client.close()

    def names(self) -> list[str]:
        """Return the names of all parameters, sorted."""
        return sorted(self._call("ListParameters", "list_parameters").result.names)

    def get(self, names: Sequence[str]) -> list[Typed] | None:
        """Return the values; None if the node does not give them, because one has none."""
        values = self._call("GetParameters", "get_parameters", names=list(names)).values
        return [from_message(value) for value in values] if len(values) == len(names) else None

    def describe(self, names: Sequence[str]) -> list[Any]:
        """Return descriptors; a node may leave out those of all names for one that is unknown."""
        answer = self._call("DescribeParameters", "describe_parameters", names=list(names))
        return list(answer.descriptors)

    def types(self, names: Sequence[str]) -> list[int]:
        """Return the numbers of types; a node may leave out all for a name that is unknown."""
        return list(self._call("GetParameterTypes", "get_parameter_types", names=list(names)).types)

    def set(self, values: Mapping[str, Typed]) -> list[Result]:
        """Set parameters one by one; return what came of each."""
        answer = self._call("SetParameters", "set_parameters", parameters=self._messages(values))
        if len(answer.results) != len(values):
            raise ToolError(
                f"{self.name} answered for {len(answer.results)} parameters, not {len(values)};"
                f" 'uros param dump {self.name}' shows what is set"
            )
        return [
            Result(name, result.successful, result.reason)
            for name, result in zip(values, answer.results, strict=True)
        ]

    def set_atomically(self, values: Mapping[str, Typed]) -> list[Result]:
        """Set all parameters or none; return the common result for each."""
        answer = self._call(
            "SetParametersAtomically", "set_parameters_atomically",
            parameters=self._messages(values),
        )  # fmt: skip
        return [Result(name, answer.result.successful, answer.result.reason) for name in values]

    def _messages(self, values: Mapping[str, Typed]) -> list[Any]:
        """Return the parameters, empty lists with the types that the node has declared."""
        from ...interfaces import load

        kind = load("rcl_interfaces/msg/Parameter")
        empty = [name for name, typed in values.items() if typed.value == []]
        declared: dict[str, int] = {}
        if empty:
            declared = dict(zip(empty, self.types(empty), strict=False))
        return [
            kind(name=name, value=to_message(as_declared(typed, declared.get(name, 0))))
            for name, typed in values.items()
        ]

    def unknown(self, names: Iterable[str]) -> str:
        """Return an error for the first name that is no parameter of the node; "" if all are."""
        known = self.names()
        for name in names:
            if name not in known:
                close = did_you_mean(name, map(printable, known))
                rest = close or f"; 'uros param list {self.name}' lists them"
                return f"{self.name} has no parameter {name!r}{rest}"
        return ""

    def advice(self, name: str, typed: Typed) -> str:
        """Return what to do about a value that the node has refused; "" if that is not known."""
        try:
            fault = self.unknown([name])
            if fault:
                return fault
            (declared,) = self.types([name])
        except (ToolError, ValueError):
            return ""
        if declared == typed.kind or ParameterType.NOT_SET in (declared, typed.kind):
            return ""
        remedy = ""
        if (declared, typed.kind) in _WITHOUT_POINT:
            remedy = "; write 1.0 in place of 1"
        elif declared == ParameterType.STRING:
            remedy = "; put quotes within the quotes: '\"1\"'"
        return (
            f"{name} is of the type {type_name(declared)}, and the value of the type"
            f" {type_name(typed.kind)}{remedy}"
        )


def parameter_node(network: Network, args: argparse.Namespace) -> ParameterNode:
    """Discover the domain and return the node of the command.

    Raises:
        ToolError: There is no such node, or it has no parameters.
    """
    discover(network, args)
    name = find_node(network, args.node, args.timeout)
    if not network.graph.servers(f"{name}/list_parameters"):
        raise ToolError(
            f"the node {name} has no parameter services; a board has them with"
            " node.declare_parameter"
        )
    return ParameterNode(network, name, args.timeout)


def list_all(
    network: Network, nodes: Iterable[str], prefixes: Sequence[str], seconds: float | None
) -> dict[str, Any]:
    """List the parameters of nodes, all at the same time.

    Args:
        network: The domain.
        nodes: The full names of the nodes.
        prefixes: Prefixes of the parameters; empty for all.
        seconds: The timeout; None for the default.

    Returns:
        The sorted names of parameters by node, or a ToolError in place of them.
    """
    calls = {
        node: _call(node, "ListParameters", "list_parameters", prefixes=list(prefixes))
        for node in nodes
    }
    answers = _answers(network, calls, seconds)
    return {
        node: answer if isinstance(answer, ToolError) else sorted(answer.result.names)
        for node, answer in answers.items()
    }


def types_of_all(
    network: Network, wanted: Mapping[str, Sequence[str]], seconds: float | None
) -> dict[str, Any]:
    """Return the names of the types of parameters of nodes, all at the same time.

    Args:
        network: The domain.
        wanted: Names of parameters by node.
        seconds: The timeout; None for the default.

    Returns:
        The types by name of the parameter, by node, or a ToolError in place of them.
    """
    calls = {
        node: _call(node, "DescribeParameters", "describe_parameters", names=list(names))
        for node, names in wanted.items()
    }
    answers = _answers(network, calls, seconds)
    return {
        node: answer
        if isinstance(answer, ToolError)
        else {each.name: type_name(each.type) for each in answer.descriptors}
        for node, answer in answers.items()
    }


def _answers(network: Network, calls: Mapping[str, Call], seconds: float | None) -> dict[str, Any]:
    answers = call_all(network, list(calls.values()), seconds or ANSWER_SECONDS)
    return dict(zip(calls, answers, strict=True))


def _call(node: str, kind: str, service: str, **request: Any) -> Call:
    from ...interfaces import load

    found = load(f"rcl_interfaces/srv/{kind}")
    return Call(f"{node}/{service}", found, found.Request(**request))
