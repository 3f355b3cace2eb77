"""Which endpoints of others speak the form that services have here, rmw_cyclonedds's.

A request in that form that rmw_fastrtps reads is executed with wrong arguments: the 16 octets of
the header stand where it expects the first fields. So each endpoint that is matched with one of a
service's is looked at. rmw_cyclonedds, and uros like it, announces ``clientid=…`` or
``serviceid=…`` in its USER_DATA; a GUID that begins 01 0F is one of Fast DDS. Whatever announces
neither id is foreign.

That alone would not be enough. A request goes to every reader that has matched the writer, and
Fast DDS may have done so before Cyclone tells us of that reader. So requests and replies are
written as Cyclone's *write-dispose*: RTPS data whose status says "disposed". Cyclone hands these to
its reader as data. Fast DDS has no such operation and reports an invalid sample, which
rmw_fastrtps does not pass on.
"""

from __future__ import annotations

from typing import Final

from . import builtin, cyclone

# What a client's and a server's endpoints announce.
CLIENT: Final = b"clientid="
SERVER: Final = b"serviceid="
# The first octets of a GUID tell the vendor; these are eProsima's, of Fast DDS.
FAST_DDS: Final = b"\x01\x0f"
# USER_DATA of second readers; see :mod:`~uros.middleware.dds.late_writer_heartbeat`. They execute
# nothing.
OFFER: Final = b"uros_offer=1;"
# Attack: writers that come and go without end, each with a sample. Verdicts kept.
MAX_KNOWN: Final = 1024


def speaks(guid: bytes, user_data: bytes, mark: bytes) -> bool:
    """Whether an endpoint has the form of rmw_cyclonedds; ``mark``: `CLIENT` or `SERVER`."""
    return mark in user_data and not guid.startswith(FAST_DDS)


class Servers:
    """The servers that a client's writer of requests is matched with."""

    def __init__(self, writer: int) -> None:
        self._writer = writer
        self._handles: set[int] = set()
        self._foreign: set[int] = set()

    def foreign(self) -> bool:
        """Whether one of them does not speak the form."""
        handles = cyclone.matched_readers(self._writer)
        if handles != self._handles:
            self._foreign &= handles
            for handle in handles - self._handles:
                about = builtin.matched_reader(self._writer, handle)
                if about is not None and not (OFFER in about[1] or speaks(*about, SERVER)):
                    self._foreign.add(handle)
            self._handles = handles
        return bool(self._foreign)


class Senders:
    """The writers whose samples come to one reader of a service."""

    def __init__(self, reader: int, mark: bytes) -> None:
        self._reader = reader
        self._mark = mark
        self._known: dict[int, bool] = {}

    def speaks(self, handle: int) -> bool:
        """Whether the writer of that instance handle speaks the form. One that has left already,
        and was never heard before, is not believed.
        """
        known = self._known.get(handle)
        if known is None:
            about = builtin.matched_writer(self._reader, handle)
            if about is None:
                return False
            if len(self._known) >= MAX_KNOWN:
                self._known.clear()
            known = self._known[handle] = speaks(*about, self._mark)
        return known
