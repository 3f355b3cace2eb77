"""YAML text as nested dicts, lists and scalars, read by PyYAML.

A plain scalar stays the text that it is, since what ``1`` or ``yes`` means is for the field to say;
`resolve` tells what YAML takes it for. What no message can be made of is refused by name.
"""

from __future__ import annotations

import re
from functools import cache
from typing import Any, Final, Union

Node = Union["Plain", str, "list[Node]", "dict[str, Node]"]


class Plain(str):
    """A scalar without quotes."""


class YamlError(Exception):
    """The text is no YAML, or none that is taken here; says where and what to do."""


_DEEPEST: Final = 64  # attack: brackets in brackets, until Python's stack is used up
_LONGEST: Final = 4300  # attack: digits that take long to make a number of; Python's own bound
_TEXT: Final = "tag:yaml.org,2002:str"  # a tag that does what quotes do; others change nothing
_MEANT: Final = [_TEXT.replace("str", kind) for kind in ("int", "float", "bool", "null")]
_TAGS: Final = [None, "!", _TEXT, *_MEANT, *(_TEXT.replace("str", kind) for kind in ("seq", "map"))]
# What PyYAML says, and what to say of it; for the rest, its own words.
_REMEDIES: Final = (
    (r"expected ',' or '(.)', but got '<stream end>'", r"the \1 is missing"),
    (r"expected ',' or '(.)'", r"a comma or \1 was expected; put longer text in quotes"),
    (r"end of stream", "the closing quote is missing"),
    (r"unknown escape", r"there is no such escape; a backslash is written as \\\\"),
    (r"sequence of (\d+) hex", r"\1 hexadecimal digits were expected"),
    (r"mapping values", "a second colon in a value; put {..} or quotes around the value"),
    (r"sequence entries", "a list begins on a line of its own, or in [brackets]"),
    (r"expected ':'", "a colon and a blank were expected behind a field's name"),
    (r"<block end>|<document start>", "here the value has ended; put longer text in quotes"),
    (r"'\\t' that", "a tab cannot stand here; put blanks"),
    (r"(.*)", r"\1; put text that holds signs in quotes"),
)


def read(text: str) -> Node:
    """The value of a document; an empty one is `Plain` and empty. Raises YamlError."""
    node = compose(text)
    return Plain("") if node is None else _value(node)


def read_all(text: str) -> list[Node]:
    """The values of all documents but the empty ones. Raises YamlError."""
    values = [_value(node) for node in _compose(text, (), several=True)]
    return [value for value in values if value != "" or type(value) is str]


def compose(text: str, *tags: str) -> Any:
    """The root node of a document as PyYAML has it, or None if it is empty.

    Args:
        text: The document.
        tags: Tags that are taken besides those of strings, numbers, lists and mappings.

    Raises:
        YamlError: The text is no YAML, or has what is not taken.
    """
    nodes = _compose(text, tags, several=False)
    return nodes[0] if nodes else None


def _compose(text: str, tags: tuple[str, ...], several: bool) -> list[Any]:
    import yaml

    foreign = yaml.SafeLoader.NON_PRINTABLE.search(text)
    if foreign:
        what = f"the character {foreign[0]!a} cannot stand in YAML; in double quotes, write it"
        raise _fault(text, foreign.start(), f"{what} as \\x.., \\u.... or \\n")
    loader = _loader()(text)
    loader.tags = [*_TAGS, *tags]
    nodes = []
    try:
        while loader.check_node():
            nodes.append(loader.get_node())
            # `topic echo` ends by ---
            if not several and len(nodes) > 1 and (len(nodes) > 2 or nodes[1].value):
                raise fault_at(nodes[-1], "another document begins; give one")
        return nodes
    except yaml.MarkedYAMLError as error:
        tried = ((re.search(said, error.problem), remedy) for said, remedy in _REMEDIES)
        what = next(match.expand(remedy) for match, remedy in tried if match)
        raise _fault(text, error.problem_mark.index, what) from None
    except (ValueError, OverflowError, RecursionError) as error:  # "\U00110000" is the first two
        what = f"no such character or number, or nested too deep ({error}); leave it out"
        raise _fault(text, loader.index, what) from None


def _fault(text: str, at: int, what: str) -> YamlError:
    near = re.split("[\0\r\n\x85\u2028\u2029]", text[at : at + 20])[0]
    where = f"line {text.count(chr(10), 0, at) + 1}, column {at - text.rfind(chr(10), 0, at)}"
    return YamlError(f"{where}, at {near!r}: {what}" if near else f"{where}: {what}")


def fault_at(found: Any, what: str) -> YamlError:
    """The error for a node or an event: where it stands, and what is wrong."""
    return _fault(found.start_mark.buffer, found.start_mark.index, what)


@cache
def _loader() -> Any:
    import yaml

    class Loader(yaml.SafeLoader):  # type: ignore[misc]
        depth = 0
        tags = _TAGS

        def compose_node(self, parent: Any, index: Any) -> Any:
            event = self.peek_event()
            if isinstance(event, yaml.AliasEvent) or event.tag not in self.tags:
                raise fault_at(event, "this would be an alias or a tag; put the text in quotes")
            self.depth += 1
            if self.depth > _DEEPEST:
                raise fault_at(event, f"nested more than {_DEEPEST} deep; give fewer brackets")
            node = super().compose_node(parent, index)
            self.depth -= 1
            if node.id == "scalar":
                node.value.encode()  # a ValueError for half a character, "\ud800"
                node.style = "'" if event.tag == _TEXT else node.style
            return node

    return Loader


def _value(node: Any) -> Node:
    if node.id == "scalar":
        return str(node.value) if node.style else Plain(node.value)
    if node.id == "sequence":
        return [_value(item) for item in node.value]
    return {name: _value(item) for name, item in pairs(node).items()}


def pairs(node: Any) -> dict[str, Any]:
    """The nodes of a mapping by name. Raises YamlError if a name is none, or stands there twice."""
    found: dict[str, Any] = {}
    for name, item in node.value:
        key = _value(name)
        if not isinstance(key, str) or (key == "<<" and isinstance(key, Plain)):
            raise fault_at(
                name, "the name of a field is a word; write the fields out, without merging"
            )
        if key in found:
            raise fault_at(name, f"{str(key)!r} stands there twice; leave one out")
        if node.flow_style and isinstance(key, Plain) and ":" in key and item.value == "":
            raise fault_at(name, f"a blank is missing behind the colon of {str(key)!r}")
        found[str(key)] = item
    return found


@cache
def _meanings() -> Any:
    return _loader()("")


def resolve(text: str) -> None | bool | int | float | str:
    """What YAML 1.1 takes a plain scalar for; text that is no number after all, and a date."""
    from yaml import ScalarNode

    return construct(ScalarNode(_meanings().resolve(ScalarNode, text, (True, False)), text))


def construct(node: Any) -> None | bool | int | float | str:
    """The value of a composed scalar by its tag; as text where it does not fit the tag."""
    text = node.value
    if node.tag in _MEANT and len(text) <= _LONGEST:
        try:
            value: None | bool | int | float
            value = _meanings().yaml_constructors[node.tag](_meanings(), node)
            return value
        except (ValueError, KeyError, OverflowError):  # 0x_, "yes\n"
            pass
    return str(text)
