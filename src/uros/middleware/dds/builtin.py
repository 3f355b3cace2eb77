"""Cyclone's builtin topics: discovered participants and endpoints with their QoS."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from typing import Any, Final, TypeVar

from cyclonedds import _clayer

from ...qos import (
    DurabilityPolicy,
    HistoryPolicy,
    LivelinessPolicy,
    QoSProfile,
    ReliabilityPolicy,
)
from .cyclone import INFINITE, STATUS_DATA_AVAILABLE, check, function, wake_on

TOPIC_PARTICIPANT: Final = 0x7FFF0001
TOPIC_PUBLICATION: Final = 0x7FFF0003
TOPIC_SUBSCRIPTION: Final = 0x7FFF0004

Qos = TypeVar("Qos")

_int32, _void_p, _int64, _size = ctypes.c_int32, ctypes.c_void_p, ctypes.c_int64, ctypes.c_size_t

_create_reader = function("dds_create_reader", _int32, _int32, _int32, _void_p, _void_p)
_free = function("dds_free", None, _void_p)
_qget_userdata = function(
    "dds_qget_userdata", ctypes.c_bool, _void_p, ctypes.POINTER(_void_p), ctypes.POINTER(_size)
)
_qget_reliability = function(
    "dds_qget_reliability",
    ctypes.c_bool,
    _void_p,
    ctypes.POINTER(ctypes.c_int),
    ctypes.POINTER(_int64),
)
_qget_durability = function(
    "dds_qget_durability", ctypes.c_bool, _void_p, ctypes.POINTER(ctypes.c_int)
)
_qget_history = function(
    "dds_qget_history",
    ctypes.c_bool,
    _void_p,
    ctypes.POINTER(ctypes.c_int),
    ctypes.POINTER(_int32),
)
_qget_deadline = function("dds_qget_deadline", ctypes.c_bool, _void_p, ctypes.POINTER(_int64))
_qget_lifespan = function("dds_qget_lifespan", ctypes.c_bool, _void_p, ctypes.POINTER(_int64))
_qget_liveliness = function(
    "dds_qget_liveliness",
    ctypes.c_bool,
    _void_p,
    ctypes.POINTER(ctypes.c_int),
    ctypes.POINTER(_int64),
)
_qget_ownership = function(
    "dds_qget_ownership", ctypes.c_bool, _void_p, ctypes.POINTER(ctypes.c_int)
)
_qget_partition = function(
    "dds_qget_partition",
    ctypes.c_bool,
    _void_p,
    ctypes.POINTER(ctypes.c_uint32),
    ctypes.POINTER(ctypes.POINTER(_void_p)),
)


def create_reader(participant: int, topic: int) -> int:
    """Create a reader of one of the ``TOPIC_…``: what its participant discovers."""
    reader: int = check(_create_reader(participant, topic, None, None), "read a builtin topic")
    wake_on(reader, STATUS_DATA_AVAILABLE)
    return reader


def take_participants(reader: int, limit: int) -> list[tuple[bytes, QoSProfile | None]]:
    """Take (GUID, QoS) of participants that were discovered or changed; QoS None: it left."""
    participants = _clayer.ddspy_take_participant(
        reader, limit, lambda key, qos, info: (key, qos if _alive(info) else None), read_qos
    )
    return [] if isinstance(participants, int) else participants


def take_endpoints(
    reader: int, limit: int
) -> list[tuple[bytes, tuple[bytes, str, str, QoSProfile] | None]]:
    """Take (GUID, (participant's GUID, topic, type, QoS)) of endpoints; None: it left."""
    return _take_endpoints(reader, limit, read_qos)


def take_types(reader: int, limit: int) -> list[tuple[bytes, tuple[bytes, str, str, None] | None]]:
    """Take endpoints as :func:`take_endpoints` does, without the QoS, which is the costly part."""
    return _take_endpoints(reader, limit, lambda _pointer: None)


def _take_endpoints(
    reader: int, limit: int, read: Callable[[int], Qos]
) -> list[tuple[bytes, tuple[bytes, str, str, Qos] | None]]:
    def convert(
        key: bytes,
        participant: bytes,
        _handle: int,
        topic: str | None,
        type_name: str | None,
        qos: Qos,
        info: Any,
        _type_id: bytes | None,
    ) -> tuple[bytes, tuple[bytes, str, str, Qos] | None]:
        if not _alive(info) or topic is None or type_name is None:
            return key, None
        return key, (participant, topic, type_name, qos)

    endpoints = _clayer.ddspy_take_endpoint(reader, limit, convert, read)
    return [] if isinstance(endpoints, int) else endpoints


def matched_reader(writer: int, handle: int) -> tuple[bytes, bytes] | None:
    """Return (GUID, USER_DATA) of a reader by its instance handle; None unless it matches."""
    return _matched(_clayer.ddspy_get_matched_subscription_data, writer, handle)


def matched_writer(reader: int, handle: int) -> tuple[bytes, bytes] | None:
    """Return (GUID, USER_DATA) of a writer by its instance handle; None unless it matches."""
    return _matched(_clayer.ddspy_get_matched_publication_data, reader, handle)


def _matched(get: Any, endpoint: int, handle: int) -> tuple[bytes, bytes] | None:
    identity: tuple[bytes, bytes] | None = get(
        endpoint, handle, lambda key, *rest: (key, rest[4]), _user_data
    )
    return identity


_ALIVE: Final = 16  # DDS_ALIVE_INSTANCE_STATE


def _alive(info: Any) -> bool:
    return bool(info.valid_data) and info.instance_state == _ALIVE


def read_qos(pointer: int) -> QoSProfile:
    """Return a ``dds_qos_t`` as a profile; a policy that is not in it keeps its default."""
    qos = QoSProfile()
    kind, number, time = ctypes.c_int(), _int32(), _int64()
    if _qget_reliability(pointer, ctypes.byref(kind), ctypes.byref(time)):
        qos.reliability = (ReliabilityPolicy.BEST_EFFORT, ReliabilityPolicy.RELIABLE)[kind.value]
    if _qget_durability(pointer, ctypes.byref(kind)):
        qos.durability = (
            DurabilityPolicy.VOLATILE,
            DurabilityPolicy.TRANSIENT_LOCAL,
            DurabilityPolicy.TRANSIENT,
            DurabilityPolicy.PERSISTENT,
        )[kind.value]
    if _qget_history(pointer, ctypes.byref(kind), ctypes.byref(number)):
        qos.history = (HistoryPolicy.KEEP_LAST, HistoryPolicy.KEEP_ALL)[kind.value]
        qos.depth = number.value
    if _qget_deadline(pointer, ctypes.byref(time)):
        qos.deadline_ms = _milliseconds(time.value)
    if _qget_lifespan(pointer, ctypes.byref(time)):
        qos.lifespan_ms = _milliseconds(time.value)
    if _qget_liveliness(pointer, ctypes.byref(kind), ctypes.byref(time)):
        by_topic = kind.value == 2
        qos.liveliness = (
            LivelinessPolicy.MANUAL_BY_TOPIC if by_topic else LivelinessPolicy.AUTOMATIC
        )
        qos.liveliness_lease_ms = _milliseconds(time.value)
    if _qget_ownership(pointer, ctypes.byref(kind)):
        qos.ownership_exclusive = kind.value == 1
    qos.partitions = _partitions(pointer)
    qos.user_data = _user_data(pointer)
    return qos


def _user_data(pointer: int) -> bytes:
    data, size = _void_p(), _size()
    content = b""
    if _qget_userdata(pointer, ctypes.byref(data), ctypes.byref(size)) and data.value:
        content = ctypes.string_at(data.value, size.value)
        _free(data)
    return content


def _milliseconds(nanoseconds: int) -> int | None:
    return None if nanoseconds == INFINITE else -(-nanoseconds // 1_000_000)


def _partitions(pointer: int) -> tuple[str, ...]:
    count, names = ctypes.c_uint32(), ctypes.POINTER(_void_p)()
    if not _qget_partition(pointer, ctypes.byref(count), ctypes.byref(names)) or not count.value:
        return ()
    partitions = []
    for index in range(count.value):
        address = names[index]
        if address is not None:
            partitions.append(ctypes.string_at(address).decode(errors="replace"))
            _free(address)
    _free(names)
    return tuple(partitions)
