"""Definitions for a bag of messages that no folder has: asked of nodes while it is recorded."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from ...bag.definitions import joined
from ..type_lookup import TypeQuestion, definitions

if TYPE_CHECKING:
    from ...host.network import Network

# The types that are asked for at the same time. Attack: a node that announces ever more types; no
# more of them wait, and the others are recorded without a definition.
_AT_ONCE: Final = 16
_MOST_WAITING: Final = 1024
# Seconds for a node to match, and to answer; and within which its service may be discovered after
# its topic. Nobody waits for that, while a topic is recorded.
_PATIENCE: Final = 5.0


class Found(NamedTuple):
    """What came of the search for a type: its definition and whose it is, or why there is none."""

    type_name: str
    text: str
    node: str
    fault: str


class DefinitionSearch:
    """Asks for many types; :meth:`turn` is called while the network is served. Close it.

    Args:
        network: The domain.
    """

    def __init__(self, network: Network) -> None:
        self._network = network
        self._waiting: deque[str] = deque()
        self._questions: dict[str, TypeQuestion] = {}

    def begin(self, type_name: str) -> bool:
        """Ask for a type; return False if too many wait."""
        if len(self._waiting) >= _MOST_WAITING:
            return False
        self._waiting.append(type_name)
        return True

    def turn(self, now: float) -> list[Found]:
        """Go on, and return what has come of types; ``now`` in seconds."""
        while self._waiting and len(self._questions) < _AT_ONCE:
            name = self._waiting.popleft()
            self._questions[name] = TypeQuestion(self._network, name, now, _PATIENCE, _PATIENCE)
        ended = [name for name, question in self._questions.items() if question.turn(now)]
        return [_found(name, self._questions.pop(name)) for name in ended]

    def close(self) -> None:
        """End all questions; idempotent."""
        self._waiting.clear()
        while self._questions:
            self._questions.popitem()[1].close()


def _found(type_name: str, question: TypeQuestion) -> Found:
    if question.answer is None:
        return Found(type_name, "", "", "no node that uses it has given it")
    try:
        return Found(type_name, text_of(question.answer), question.node, "")
    except ValueError as error:
        return Found(type_name, "", "", f"that of {question.node} cannot be used: {error}")


def text_of(answer: Any) -> str:
    """Return the definitions of a ``GetTypeDescription`` response as bags carry them.

    Raises:
        ValueError: They are not those of a message, or one that is nested is missing.
    """
    from ...interfaces.parse import parse_msg

    texts = definitions(answer)
    for name, text in texts.items():
        package, _, plain = name.split("/")
        missing = set(parse_msg(text, package, plain).nested) - texts.keys()
        if missing:
            raise ValueError(f"{name} nests {min(missing)}, which is not defined")
    return joined(texts)
