"""``uros param set``: set parameters."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence

from ...printable import printable
from ..common import add_served_node, join
from ..errors import ToolError, UsageError
from .node import ParameterNode, Result, parameter_node
from .values import Typed, from_text


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros param set``."""
    add_served_node(parser)
    parser.add_argument(
        "pairs", metavar="PARAMETER VALUE", nargs="+",
        help="names of parameters, each with its value in YAML, such as 1, 1.0, true, text or"
        " '[1, 2]'; put -- in front of NODE where a value begins with a minus and is no number",
    )  # fmt: skip
    parser.add_argument(
        "--atomic", action="store_true", help="set all of the parameters, or none of them"
    )


def run(args: argparse.Namespace) -> int:
    """Set parameters.

    Returns:
        1 if the node has refused one of them, else 0.

    Raises:
        UsageError: A name has no value, or a value cannot be sent.
        ToolError: There is no such node, or it does not answer.
    """
    values = _values(args.pairs)
    with join(args) as network:
        node = parameter_node(network, args)
        results = node.set_atomically(values) if args.atomic else node.set(values)
        alone = len(results) == 1
        return report(
            node, values, results,
            "Set parameter successful" if alone else "Set parameter {} successful",
            "Setting parameter failed" if alone else "Set parameter {} failed",
        )  # fmt: skip


def _values(pairs: Sequence[str]) -> dict[str, Typed]:
    """Return the values of ``PARAMETER VALUE ...`` by name."""
    if len(pairs) % 2:
        raise UsageError(f"there is no value for the parameter {pairs[-1]!r}: give PARAMETER VALUE")
    values: dict[str, Typed] = {}
    for name, text in zip(pairs[::2], pairs[1::2], strict=True):
        if name in values:
            raise UsageError(f"the parameter {name!r} is given twice")
        try:
            values[name] = from_text(text)
        except ToolError as error:
            raise UsageError(f"{name}: {error}") from error
    return values


def report(
    node: ParameterNode,
    values: Mapping[str, Typed],
    results: Sequence[Result],
    done: str,
    failed: str,
) -> int:
    """Print what came of each parameter.

    Args:
        node: The node, which is asked why it has refused a value.
        values: The values that were to be set.
        results: What the node has answered.
        done: The line for success, with ``{}`` for the parameter's name.
        failed: The line for failure.

    Returns:
        1 if a parameter was not set, else 0.
    """
    status = 0
    for result in results:
        reason = f": {result.reason}" if result.reason else ""
        if result.successful:
            print(printable(done.format(result.name) + reason))
            continue
        status = 1
        advice = node.advice(result.name, values[result.name])
        if advice:
            reason += f" ({advice})"
        print(printable(failed.format(result.name) + reason), file=sys.stderr)
    return status
