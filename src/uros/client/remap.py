"""Remapping rules, as with ``--ros-args -r``, and node options from a file.

::

    node = Node("talker", transport, remap=Remap("chatter:=/news", "__ns:=/garden"))
    node = Node(**options("node.json"), transport=transport)

Rules are those of rclpy; the first that matches applies: ``chatter:=/news`` for topics and
services, ``rostopic://a:=b`` and ``rosservice://a:=b`` for one of them, ``~/a:=b`` for private
names, ``__node:=other`` and ``__ns:=/garden`` for the node itself; ``talker:a:=b`` applies to nodes
of that name only. ``{node}`` and ``{ns}`` (or ``{namespace}``) in names of topics and services are
replaced if the node has a Remap, even one without rules.
"""

import json

from .node import check_name

try:
    from typing import Any
except ImportError:  # MicroPython
    pass

_SCHEMES = ("rostopic://", "rosservice://")


class Remap:
    """Remapping rules for the names of nodes, topics and services.

    Raises:
        ValueError: A rule is malformed.
    """

    def __init__(self, *rules: str) -> None:
        # (node or "" for all, kind: 0 topics, 1 services, 2 both, name to match, new name)
        self._rules = [_rule(rule) for rule in rules]

    def node(self, name: str, namespace: str) -> "tuple[str, str]":
        """Return a node's name and namespace after remapping."""
        name = self._find(("__node", "__name"), name) or name
        return name, self._find(("__ns",), name) or namespace

    def _find(self, keys: "tuple[str, ...]", node: str) -> str:
        for only, _, match, new in self._rules:
            if match in keys and only in ("", node):
                return new
        return ""

    def name(self, node: "Any", name: str, service: bool) -> str:
        """Return the full name of a node's topic or service after remapping."""
        for key, value in (
            ("{node}", node.name), ("{ns}", node.namespace), ("{namespace}", node.namespace),
        ):  # fmt: skip
            name = name.replace(key, value)
        full: str = node.resolve(name)
        for only, kind, match, new in self._rules:
            if only in ("", node.name) and kind != 1 - service:
                if not match.startswith("__") and node.resolve(match) == full:
                    return node.resolve(new)  # type: ignore[no-any-return]
        return full


def _rule(text: str) -> "tuple[str, int, str, str]":
    match, mark, new = text.partition(":=")
    try:
        if not mark or ":=" in new:
            raise ValueError("has one := between two names")
        kind = 2
        only = ""
        at = match.find(":")
        if at >= 0 and match[at : at + 3] != "://":
            only = check_name(match[:at], "a node's name", 0)
            match = match[at + 1 :]
        for i in range(2):
            if match.startswith(_SCHEMES[i]):
                match = match[len(_SCHEMES[i]) :]
                kind = i
        if match in ("__node", "__name"):
            check_name(new, "a node's name", 0)
        elif match == "__ns":
            if not new.startswith("/"):
                raise ValueError("%r: a namespace begins with /" % new)
            if new != "/":
                check_name(new[1:], "a namespace")
        else:
            for name in (match, new):
                if name.startswith("~/"):
                    name = name[2:]
                elif name.startswith("/"):
                    name = name[1:]
                check_name(name, "a topic's or service's name")
    except ValueError as error:
        raise ValueError("%r is no remapping rule: %s" % (text, error))
    return only, kind, match, new


def from_arguments(arguments: "list[str]") -> "Remap":
    """Return the rules in ``--ros-args -r a:=b --remap c:=d``; other arguments are ignored."""
    rules = []
    inside = False
    for i in range(len(arguments)):
        if arguments[i] == "--ros-args":
            inside = True
        elif arguments[i] == "--":
            inside = False
        elif inside and arguments[i] in ("-r", "--remap"):
            if i + 1 == len(arguments):
                raise ValueError("%s needs a rule behind it, as a:=b" % arguments[i])
            rules.append(arguments[i + 1])
    return Remap(*rules)


_KEYS = ("name", "namespace", "domain_id", "key", "limit", "ping_ms", "silence_ms", "wait_ms")


def options(source: "Any") -> "dict[str, Any]":
    """Return arguments for :class:`~uros.client.node.Node` from a JSON file on the board or a dict.

    The options are ``name``, ``namespace``, ``domain_id``, ``key``, ``limit``, ``ping_ms``,
    ``silence_ms``, ``wait_ms``, and ``remap``, a list of rules.

    Raises:
        OSError: The file cannot be read.
        ValueError: An option is wrong; the message says which.
    """
    where = "the node's options"
    if isinstance(source, str):
        where = source
        with open(source) as file:
            text = file.read()
        try:
            source = json.loads(text)
        except ValueError:
            raise ValueError('%s is no JSON; write {"name": "talker"}' % where)
    if not isinstance(source, dict):
        raise ValueError("%s: an object of names and values is wanted" % where)
    out = {}
    for key in source:
        if key == "remap":
            rules = source[key]
            if not isinstance(rules, (list, tuple)):
                raise ValueError('%s: remap is a list of rules as "a:=b"' % where)
            out[key] = Remap(*rules)
        elif key in _KEYS:
            kind = str if key in _KEYS[:2] else int
            if not isinstance(source[key], kind):
                word = "text" if kind is str else "number"
                raise ValueError("%s: %s is a %s" % (where, key, word))
            out[key] = source[key]
        else:
            raise ValueError(
                "%s: a node has no option %r, but %s, remap" % (where, key, ", ".join(_KEYS))
            )
    return out
