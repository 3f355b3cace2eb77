"""Topics whose endpoints have different types: DDS does not match them and does not say so."""

from __future__ import annotations

from collections.abc import Callable


class TypeConflicts:
    """The types of all endpoints in one domain, and which of them conflict with ours.

    Args:
        report: Called with (topic, our type, the other type), whichever endpoint came first.
    """

    def __init__(self, report: Callable[[str, str, str], None]) -> None:
        self._report = report
        # By GUID: topic, type, and whether it is ours; and by topic: the GUIDs.
        self._endpoints: dict[bytes, tuple[str, str, bool]] = {}
        self._topics: dict[str, set[bytes]] = {}

    def add(self, guid: bytes, topic: str, type_name: str, is_ours: bool) -> None:
        """Compare a discovered endpoint with those of its topic; a known one is ignored."""
        if guid in self._endpoints:
            return
        self._endpoints[guid] = topic, type_name, is_ours
        guids = self._topics.setdefault(topic, set())
        for other_guid in guids:
            _, other_type, other_is_ours = self._endpoints[other_guid]
            if other_type != type_name:
                if is_ours:
                    self._report(topic, type_name, other_type)
                elif other_is_ours:
                    self._report(topic, other_type, type_name)
        guids.add(guid)

    def remove(self, guid: bytes) -> None:
        """Forget an endpoint, which has left."""
        endpoint = self._endpoints.pop(guid, None)
        if endpoint is not None:
            guids = self._topics[endpoint[0]]
            guids.discard(guid)
            if not guids:
                del self._topics[endpoint[0]]
