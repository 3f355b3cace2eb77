"""Parameter files: YAML as ``ros2 param dump`` writes it, and as nodes take it with --params-file.

Below the name of a node, ``ros__parameters`` has parameters, nested by the dots of their names.
Names of nodes may be nested by namespaces, and may be wildcards: ``*`` stands for one part of a
name, ``**`` for any number of parts.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from ..errors import ToolError, did_you_mean
from ..values.yaml_read import YamlError, compose, fault_at, pairs
from .values import BINARY, Typed, from_node

_SECTION: Final = "ros__parameters"


def read_file(path: str, node: str, use_wildcard: bool = True) -> dict[str, Typed]:
    """Return the parameters that a file has for a node, by name, in the order of the file.

    What stands below the node's own name takes precedence over what stands below wildcards.

    Args:
        path: The file.
        node: The node's full name.
        use_wildcard: Whether wildcards count.

    Raises:
        ToolError: The file cannot be read, does not fit (which line, what is expected), or has
            nothing for the node.
    """
    try:
        text = Path(path).read_bytes().decode("utf-8-sig")
    except OSError as error:
        raise ToolError(f"{path} cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise ToolError(f"{path} is not text in UTF-8: {error}") from error
    try:
        return read_text(text, node, use_wildcard)
    except YamlError as error:
        raise ToolError(f"{path}: {error}") from error
    except _NothingForNodeError as error:
        raise ToolError(f"{path} {error}") from error


class _NothingForNodeError(Exception):
    """A file has no parameters for a node."""


def read_text(text: str, node: str, use_wildcard: bool = True) -> dict[str, Typed]:
    """Return the parameters that the text of a file has for a node; see `read_file`."""
    root = compose(text, BINARY)
    sections = [] if root is None else list(_sections(root, ""))
    exact: dict[str, Typed] = {}
    by_wildcard: dict[str, Typed] = {}
    found = False
    for name, section in sections:
        values = dict(_parameters(section, ""))  # of all nodes: a fault anywhere is reported
        if name == node:
            found = True
            exact.update(values)
        elif use_wildcard and "*" in name and _matches(name.split("/"), node.split("/")):
            found = True
            by_wildcard.update(values)
    if not found:
        names = [name for name, _ in sections]
        raise _NothingForNodeError(
            f"has no parameters for {node}; it has those of {', '.join(names) or 'no node'}"
            f"{did_you_mean(node, names)}"
        )
    return {**by_wildcard, **exact}


def _sections(node: Any, name: str) -> Iterator[tuple[str, Any]]:
    """Yield the name of each node and its ``ros__parameters``."""
    if node.id != "mapping":
        raise fault_at(node, "names of nodes were expected, each with ros__parameters below it")
    for key, inner in pairs(node).items():
        if key == _SECTION:
            if not name:
                raise fault_at(inner, f"the name of a node was expected above {_SECTION}")
            yield name, inner
        else:
            parts = [part for part in key.split("/") if part]
            yield from _sections(inner, "/".join([name, *parts]))


def _matches(pattern: list[str], name: list[str]) -> bool:
    """Return whether the parts of a name match those of a pattern."""
    if not pattern or not name:
        return all(part == "**" for part in pattern) and not name
    if pattern[0] == "**":
        return _matches(pattern[1:], name) or _matches(pattern, name[1:])
    return pattern[0] in ("*", name[0]) and _matches(pattern[1:], name[1:])


def _parameters(node: Any, prefix: str) -> Iterator[tuple[str, Typed]]:
    """Yield the full names of parameters with their values."""
    if node.id == "scalar" and not node.value and node.style is None:
        return  # a name with nothing below it
    if node.id != "mapping":
        raise fault_at(node, f"names of parameters were expected below {_SECTION}")
    for key, inner in pairs(node).items():
        if inner.id == "mapping":
            yield from _parameters(inner, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", from_node(inner)
