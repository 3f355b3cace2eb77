"""Which matched endpoints of a service use the header of rmw_cyclonedds.

Each endpoint that matches one of a service's is checked (:mod:`uros.middleware.services.form`).
That alone would not be enough: a request goes to every reader that has matched the writer, and Fast
DDS may have done so before Cyclone tells us of that reader. So requests and replies are written as
Cyclone's *write-dispose*, RTPS data with the status "disposed". Cyclone hands these to its reader
as data. Fast DDS has no such operation and reports an invalid sample, which rmw_fastrtps does not
pass on.
"""

from __future__ import annotations

from typing import Final

from ..services.form import SERVICE_ID, uses_request_header
from ..user_data import PROBE_READER
from . import builtin, cyclone

# The most writers whose result is remembered, because writers may be created and deleted without
# end, each with a sample.
MAX_KNOWN: Final = 1024


class MatchedServers:
    """The servers that match the writer of a service client's requests."""

    def __init__(self, writer: int) -> None:
        self._writer = writer
        self._handles: set[int] = set()
        self._incompatible: set[int] = set()

    def has_incompatible(self) -> bool:
        """Return whether one of them does not use the header."""
        handles = cyclone.matched_readers(self._writer)
        if handles != self._handles:
            self._incompatible &= handles
            for handle in handles - self._handles:
                reader = builtin.matched_reader(self._writer, handle)
                if reader is None or PROBE_READER in reader[1]:
                    continue
                if not uses_request_header(*reader, SERVICE_ID):
                    self._incompatible.add(handle)
            self._handles = handles
        return bool(self._incompatible)


class MatchedWriters:
    """The writers whose samples one reader of a service gets.

    Args:
        reader: The reader.
        role: What the writers announce in USER_DATA: CLIENT_ID or SERVICE_ID.
    """

    def __init__(self, reader: int, role: bytes) -> None:
        self._reader = reader
        self._role = role
        self._known: dict[int, bool] = {}

    def is_compatible(self, handle: int) -> bool:
        """Return whether the writer of an instance handle uses the header.

        False for a writer that has left already and was never seen before.
        """
        compatible = self._known.get(handle)
        if compatible is None:
            writer = builtin.matched_writer(self._reader, handle)
            if writer is None:
                return False
            if len(self._known) >= MAX_KNOWN:
                self._known.clear()
            compatible = self._known[handle] = uses_request_header(*writer, self._role)
        return compatible
