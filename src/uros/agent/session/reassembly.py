"""Finds the message in fragments of a reliable stream after a client gave up another half-way.

A C client writes a long message piece by piece (``uxr_prepare_output_stream_fragmented``). If it
runs out of time, the first fragments of the message stay in the stream, each as long as a message
of the stream can take, and the fragments of the next message follow. No sequence number is missing,
so both are reassembled into one message. The length in the first submessage header tells them
apart. All C clients from 1.1 to 3.0 write one of these forms:

* exact: the length is that of the payload modulo 2^16, and up to 3 octets of padding follow;
* long: the length is 0, and the payload, of over 64 kB, runs to the end (from 2.1 on);
* 2.0: the last fragment is as long as the first, and its length includes octets that do not belong
  to the message: up to one octet less than a fragment. A single fragment of later clients is like
  this, too.

Octets that fit none of these forms are more than one message. In the long form the length is
unknown. In that form, and to find the message after an abandoned one, the beginning of another
WRITE_DATA is searched at the beginning of each fragment: the same flags, a later request, a known
datawriter (if there are two messages for certain, also a requester or replier), and a length that
fits what follows.
"""

from __future__ import annotations

from collections.abc import Container
from typing import Final

from ...wire import ids
from ...wire.streams import sequence_after

# The submessage header and the ids of request and object.
_HEAD: Final = 8
# The most candidates that are checked, because a message may consist of nothing but the octet of
# WRITE_DATA. A picture of 8 MiB in fragments of 512 bytes has some sixty such octets at the
# beginning of a fragment.
_LOOKS: Final = 4096
# Kinds of objects, the low four bits of an id, that WRITE_DATA is for besides datawriters.
_SERVICES: Final = (ids.KIND_REQUESTER, ids.KIND_REPLIER)
NONE: Final = -1


def surplus(whole: bytearray, start: int = 0) -> int:
    """Return the octets after the submessage at ``start``, modulo 2^16; 0 if it has no length."""
    announced = whole[start + 2] | whole[start + 3] << 8
    size = len(whole) - start - 4
    return (size - announced) & 0xFFFF if announced or size <= 0xFFFF else 0


def fits(whole: bytearray, start: int, first: int, last: int) -> bool:
    """Return whether ``whole[start:]`` can be one submessage of a C client, by its length.

    Args:
        whole: The reassembled fragments.
        start: Where the submessage starts.
        first: The length of its first fragment, 0 if unknown.
        last: The length of its last fragment.
    """
    size = len(whole) - start - 4
    if (whole[start + 2] | whole[start + 3] << 8) > size:
        return False
    extra = surplus(whole, start)
    return extra < 4 or extra < last and first in (0, last)


def beginning(whole: bytearray, first: int, last: int, writers: Container[int]) -> int:
    """Return where the last message in ``whole`` begins.

    Args:
        whole: The reassembled fragments.
        first: The length of the first fragment, 0 if unknown.
        last: The length of the last fragment.
        writers: The ids of the client's datawriters.

    Returns:
        0 if ``whole`` is one message; NONE if it is more than one and the last cannot be found.
    """
    whole_fits = fits(whole, 0, first, last)
    length_is_known = whole[2] or whole[3] or len(whole) - 4 <= 0xFFFF
    if whole_fits and length_is_known:
        return 0
    otherwise = 0 if whole_fits else NONE
    if len(whole) < _HEAD or (whole_fits and not first):
        return otherwise
    # After a restart of the agent the fragments' length is unknown: any octet may begin one.
    step = first or 1
    request = whole[4] << 8 | whole[5]
    kinds = whole[step::step]
    at = len(kinds)
    for _ in range(_LOOKS):
        at = kinds.rfind(ids.WRITE_DATA, 0, at)
        if at < 0:
            break
        start = (at + 1) * step
        if (
            start + _HEAD <= len(whole)
            and whole[start : start + 2] == whole[:2]
            and (
                (whole[start + 6] << 8 | whole[start + 7]) in writers
                # If there are two messages for certain, the test for the second may be weaker.
                or (not whole_fits and whole[start + 7] & 0x0F in _SERVICES)
            )
            and sequence_after(whole[start + 4] << 8 | whole[start + 5], request)
            and fits(whole, start, first or NONE, last)
        ):
            return start
    return otherwise


def long_stop(stop: int, start: int, end: int) -> int:
    """Return where a submessage of over 64 kB ends.

    C clients write the length 0, and it ends with the message, or the low 16 bits of its length,
    and up to 3 octets of padding follow.

    Args:
        stop: Where it would end if its length were the whole one.
        start: Where its payload starts.
        end: Where the message ends.
    """
    padding = (end - stop) & 0xFFFF
    return end - padding if stop != start and padding < 4 else end
