"""YAML text as nested dicts, lists and scalars, read by PyYAML.

A plain scalar stays the text that it is, since what ``1`` or ``yes`` means is for the field to say;
`resolve` tells what YAML takes it for. What no message can be made of is refused by name: aliases,
merging, tags that say something else than the value, names of fields that are no words.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import cache
from typing import Any, Final, Union

Node = Union["Plain", str, "list[Node]", "dict[str, Node]"]


class Plain(str):
    """A scalar without quotes."""


class YamlError(ValueError):
    """The text is no YAML, or none that is taken here; says where and what to do."""


# Attack: brackets in brackets, until Python's stack is used up.
_DEEPEST: Final = 64
# Attack: digits that take long to make a number of. Python itself reads no more of them.
_LONGEST: Final = 4300
_SURROGATE: Final = re.compile("[\ud800-\udfff]")
_CORE: Final = "tag:yaml.org,2002:"
_TAGS: Final = {"int": (int,), "float": (int, float), "bool": (bool,), "null": (type(None),)}
# What PyYAML says, and what to say of it; for the rest, its own words.
_REMEDIES: Final = (
    (r"expected ',' or '(.)', but got '<stream end>'", r"the \1 is missing"),
    (r"expected ',' or '(.)'", r"a comma or \1 was expected; put longer text in quotes"),
    (r"end of stream", "the closing quote is missing"),
    (r"document separator", "another document begins within the quotes; close them"),
    (r"unknown escape", r"there is no such escape; a backslash is written as \\\\"),
    (r"sequence of (\d+) hex", r"\1 hexadecimal digits were expected"),
    (r"mapping values", "a second colon in a value; put {..} or quotes around the value"),
    (r"sequence entries", "a list begins on a line of its own, or in [brackets]"),
    (r"expected ':'", "a colon and a blank were expected behind a field's name"),
    (r"<block end>|<document start>", "here the value has ended; put longer text in quotes"),
    (r"node content", "a value was expected; put signs alone in quotes"),
    (r"'\\t' that", "a tab stands before it; indent by blanks"),
    (r"'(.)' that", r"no value begins with \1; put the text in quotes"),
)


def read(text: str) -> Node:
    """The value of a document; an empty one is `Plain` and empty. Raises YamlError."""
    import yaml

    try:
        loader = yaml.SafeLoader(text)
    except yaml.reader.ReaderError as error:
        what = f"the character {text[error.position]!a} cannot stand in YAML; in double quotes,"
        raise _fault(text, error.position, f"{what} write it as \\x.., \\u.... or \\n") from None
    try:
        return _Reader(text, loader).document()
    except yaml.MarkedYAMLError as error:
        said = str(error.problem)
        found = [(re.search(pattern, said), remedy) for pattern, remedy in _REMEDIES]
        told = [match.expand(remedy) for match, remedy in found if match]
        what = told[0] if told else f"{said}; put the text in quotes"
        raise _fault(text, error.problem_mark.index, what) from None
    except YamlError:
        raise
    except (ValueError, OverflowError):  # "\U00110000", or a version of 5000 digits
        raise _fault(text, loader.index, "there is no such character or number") from None
    except RecursionError:
        raise _fault(text, loader.index, "nested too deep; give fewer brackets") from None


def _fault(text: str, at: int, what: str) -> YamlError:
    near = re.split("[\r\n\x85\u2028\u2029]", text[at : at + 20])[0]
    where = f"line {text.count(chr(10), 0, at) + 1}, column {at - text.rfind(chr(10), 0, at)}"
    return YamlError(f"{where}, at {near!r}: {what}" if near else f"{where}: {what}")


class _Reader:
    """The value that PyYAML's events make."""

    def __init__(self, text: str, loader: Any) -> None:
        import yaml

        self._text = text
        self._kinds = yaml.events
        self._events: Iterator[Any] = iter(loader.get_event, None)
        self._depth = 0

    def document(self) -> Node:
        documents: list[Node] = []
        for event in self._events:
            if isinstance(event, self._kinds.DocumentStartEvent):
                documents.append(self._value(next(self._events)))
                if documents[1:] not in ([], [""]):  # `topic echo` ends by ---, and nothing
                    raise self._fault(event, "another document begins; give one")
        return documents[0] if documents else Plain("")

    def _fault(self, event: Any, what: str) -> YamlError:
        return _fault(self._text, event.start_mark.index, what)

    def _value(self, event: Any) -> Node:
        """What begins by ``event``; the events up to its end are taken."""
        if isinstance(event, self._kinds.AliasEvent):
            raise self._fault(event, "this would be an alias; write it out, or put it in quotes")
        if isinstance(event, self._kinds.ScalarEvent):
            return self._scalar(event)
        self._depth += 1
        if self._depth > _DEEPEST:
            raise self._fault(event, f"nested more than {_DEEPEST} deep; give fewer brackets")
        is_list = isinstance(event, self._kinds.SequenceStartEvent)
        self._untagged(event, event.tag == _CORE + ("seq" if is_list else "map"))
        value = self._items() if is_list else self._pairs(event.flow_style)
        self._depth -= 1
        return value

    def _untagged(self, event: Any, fits: bool) -> None:
        if event.tag not in (None, "!") and not fits:
            raise self._fault(event, "this would be a tag; leave it out, or put the text in quotes")

    def _items(self) -> list[Node]:
        items: list[Node] = []
        for event in self._events:
            if isinstance(event, self._kinds.SequenceEndEvent):
                break
            items.append(self._value(event))
        return items

    def _pairs(self, in_braces: bool) -> dict[str, Node]:
        pairs: dict[str, Node] = {}
        for event in self._events:
            if isinstance(event, self._kinds.MappingEndEvent):
                break
            key = self._value(event)
            if not isinstance(key, str):
                raise self._fault(event, "the name of a field is a word, and no list or fields")
            if key == "<<" and isinstance(key, Plain):
                raise self._fault(event, "merging (<<) is not known here; write the fields out")
            if key in pairs:
                raise self._fault(event, f"{str(key)!r} stands there twice; leave one out")
            value = self._value(next(self._events))
            if in_braces and isinstance(key, Plain) and ":" in key and value == "":
                raise self._fault(event, f"a blank is missing behind the colon of {str(key)!r}")
            pairs[str(key)] = value
        return pairs

    def _scalar(self, event: Any) -> str:
        """The text that stands there; a tag may only say what it is anyway, or that it is text."""
        text: str = event.value
        if _SURROGATE.search(text):
            raise self._fault(event, "there is no such character; write it as \\U........")
        kind = (event.tag or "").removeprefix(_CORE)
        self._untagged(event, kind == "str" or type(resolve(text)) in _TAGS.get(kind, ()))
        return text if kind == "str" or (event.style and not kind) else Plain(text)


@cache
def _meanings() -> Any:
    import yaml

    return yaml.SafeLoader("")


def resolve(text: str) -> None | bool | int | float | str:
    """What YAML 1.1 takes a plain scalar for; a date stays text, and what is no number after all."""
    from yaml import ScalarNode

    loader = _meanings()
    tag = loader.resolve(ScalarNode, text, (True, False))
    value: None | bool | int | float | str = str(text)
    if tag.removeprefix(_CORE) in _TAGS and len(text) <= _LONGEST:
        try:
            value = loader.yaml_constructors[tag](loader, ScalarNode(tag, value))
        except (ValueError, KeyError, OverflowError):
            pass
    return value
