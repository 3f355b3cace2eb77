"""Which topics of a network or of a bag are meant: names, types and regular expressions.

A topic belongs to the topics, to the services (``/go/_service_event``, the events of service
introspection), or to the actions (feedback, status and the events of the three services of an
action). Services and actions are selected by their own names.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

from ... import names

_EVENTS: Final = "/_service_event"
_ACTION: Final = re.compile(
    r"(.+)/_action/(?:feedback|status|(?:send_goal|get_result|cancel_goal)/_service_event)"
)


@dataclass(frozen=True)
class Names:
    """The names that are meant of one kind: all or some, but none of the excluded ones."""

    every: bool = False
    included: frozenset[str] = frozenset()
    excluded: frozenset[str] = frozenset()


@dataclass(frozen=True)
class Selection:
    """What is recorded or played.

    Attributes:
        topics: Topics by name.
        services: Services by name.
        actions: Actions by name.
        types: Types whose topics are meant.
        excluded_types: Types whose topics are not.
        regex: Finds further names of topics, services and actions.
        excluded_regex: Finds names that are not meant.
        hidden: Whether hidden names are meant that are not included by name.
    """

    topics: Names = Names()
    services: Names = Names()
    actions: Names = Names()
    types: frozenset[str] = frozenset()
    excluded_types: frozenset[str] = frozenset()
    regex: re.Pattern[str] | None = None
    excluded_regex: re.Pattern[str] | None = None
    hidden: bool = False

    def takes(self, topic: str, type_name: str) -> bool:
        """Return whether a topic is meant."""
        is_topic = True
        group, name = self.topics, topic
        action = _ACTION.fullmatch(topic)
        if action:
            is_topic, group, name = False, self.actions, action[1]
        elif topic.endswith(_EVENTS):
            is_topic, group, name = False, self.services, topic[: -len(_EVENTS)]
        if name in group.excluded or topic in self.topics.excluded:
            return False
        if self.excluded_regex is not None and self.excluded_regex.search(name):
            return False
        if is_topic and type_name in self.excluded_types:
            return False
        if topic in self.topics.included or name in group.included:
            return True
        if names.is_hidden(name) and not self.hidden:
            return False
        if group.every or (is_topic and type_name in self.types):
            return True
        if action and self.hidden and self.topics.every and not topic.endswith(_EVENTS):
            return True
        return self.regex is not None and bool(self.regex.search(name))

    @property
    def is_empty(self) -> bool:
        """Whether no topic can be meant."""
        groups = (self.topics, self.services, self.actions)
        return not (
            any(group.every or group.included for group in groups) or self.types or self.regex
        )

    def missing(self, present: Iterable[str]) -> list[str]:
        """Return the included names of topics, services and actions without a topic, sorted."""
        found: set[str] = set()
        for topic in present:
            action = _ACTION.fullmatch(topic)
            found |= {topic, action[1] if action else topic.removesuffix(_EVENTS)}
        wanted = self.topics.included | self.services.included | self.actions.included
        return sorted(wanted - found)
