"""The kinds of submessages (RTPS 9.4.5), as they are read."""

from __future__ import annotations

from typing import NamedTuple, final

from .locators import Locator


@final
class Data(NamedTuple):
    """DATA: a whole sample, or the key of an instance.

    Attributes:
        reader: Entity id of the reader; zeros for all readers of the writer.
        writer: Entity id of the writer.
        number: The sequence number.
        inline_qos: The parameter list as octets; None without one.
        payload: The serialized sample or key, with its encapsulation header; None without one.
        is_key: Whether the payload is a key.
        little: Byte order of the inline QoS.
    """

    reader: bytes
    writer: bytes
    number: int
    inline_qos: bytes | None
    payload: memoryview | None
    is_key: bool
    little: bool


@final
class DataFrag(NamedTuple):
    """DATA_FRAG: consecutive fragments of a sample.

    Attributes:
        reader: Entity id of the reader; zeros for all readers of the writer.
        writer: Entity id of the writer.
        number: The sequence number of the sample.
        first: Number of the first fragment, from 1.
        fragments: How many fragments are in this submessage.
        fragment_size: Octets of each fragment but the sample's last.
        sample_size: Octets of the whole sample.
        inline_qos: The parameter list as octets; None without one.
        payload: The fragments.
        is_key: Whether the sample is a key.
        little: Byte order of the inline QoS.
    """

    reader: bytes
    writer: bytes
    number: int
    first: int
    fragments: int
    fragment_size: int
    sample_size: int
    inline_qos: bytes | None
    payload: memoryview
    is_key: bool
    little: bool


@final
class Heartbeat(NamedTuple):
    """HEARTBEAT: the sequence numbers that a writer has, none where last is first - 1."""

    reader: bytes
    writer: bytes
    first: int
    last: int
    counter: int
    final: bool
    liveliness: bool


@final
class AckNack(NamedTuple):
    """ACKNACK: a reader has everything below ``base`` and lacks ``missing``."""

    reader: bytes
    writer: bytes
    base: int
    missing: tuple[int, ...]
    counter: int
    final: bool


@final
class Gap(NamedTuple):
    """GAP: numbers from ``start`` to below ``base``, and ``irrelevant``, are not for the reader."""

    reader: bytes
    writer: bytes
    start: int
    base: int
    irrelevant: tuple[int, ...]


@final
class NackFrag(NamedTuple):
    """NACK_FRAG: a reader lacks these fragments of a sample."""

    reader: bytes
    writer: bytes
    number: int
    missing: tuple[int, ...]
    counter: int


@final
class HeartbeatFrag(NamedTuple):
    """HEARTBEAT_FRAG: a writer has fragments of a sample up to ``last``."""

    reader: bytes
    writer: bytes
    number: int
    last: int
    counter: int


@final
class InfoTimestamp(NamedTuple):
    """INFO_TS: the source time of what follows, in nanoseconds since 1970; None: unknown."""

    time_ns: int | None


@final
class InfoDestination(NamedTuple):
    """INFO_DST: what follows is for this participant alone; zeros: for all."""

    prefix: bytes


@final
class InfoSource(NamedTuple):
    """INFO_SRC: what follows comes from this participant."""

    version: bytes
    vendor: bytes
    prefix: bytes


@final
class InfoReply(NamedTuple):
    """INFO_REPLY or INFO_REPLY_IP4: where a reader wants the answers to what follows.

    Attributes:
        unicast: The locators of UDP; those of other transports are left out, as are the multicast
            ones, because an answer is for one reader.
    """

    unicast: tuple[Locator, ...]


Submessage = (
    Data | DataFrag | Heartbeat | AckNack | Gap | NackFrag | HeartbeatFrag | InfoTimestamp
    | InfoDestination | InfoSource | InfoReply
)  # fmt: skip
