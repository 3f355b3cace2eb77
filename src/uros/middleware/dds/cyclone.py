"""Cyclone DDS by its C interface: entities as integers, samples as raw CDR.

The ``cyclonedds`` wheel brings the C library and a binding that writes and
takes CDR as bytes (``_clayer``). The rest is called through ctypes, because
the binding's entity objects cost memory and cannot wait without the GIL.

A topic created by the binding announces XTypes type information derived from its
Python class. Here the class is only a name, so that must not be announced: peers
would compare it with theirs and not match. rmw_cyclonedds announces none, and
types then match by name. A sertype's first word points at its operations
table; :func:`_disable_type_information` points it at a copy without ``type_id``,
``type_map`` and ``type_info``. The layout that this relies on is checked at run time,
and the dependency is pinned.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from typing import Any, Final

from cyclonedds import _clayer
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import uint8
from cyclonedds.internal import DDS

from ...qos import (
    DurabilityPolicy,
    HistoryPolicy,
    LivelinessPolicy,
    QoSProfile,
)
from ..base import MAX_PAST, Bytes, MiddlewareError

INFINITE: Final = 0x7FFFFFFFFFFFFFFF
RETCODE_TIMEOUT: Final = -10
RETCODE_OUT_OF_RESOURCES: Final = -5
STATUS_DATA_AVAILABLE: Final = 1 << 8  # taking resets it
STATUS_PUBLICATION_MATCHED: Final = 1 << 11
STATUS_SUBSCRIPTION_MATCHED: Final = 1 << 12
# sample, view and instance states of dds_take: all of them
ANY_STATE: Final = 0x7F
NOT_READ: Final = 0x7E  # the same, of samples that were not read yet
_SERTYPE_OPS_SIZE: Final = 14
_SERTYPE_OPS_TYPES: Final = (8, 9, 10)  # type_id, type_map, type_info
_SERTYPE_OPS_EMPTY: Final = (1, 12, 13)  # arg, get_serialized_size, serialize_into

_lib: Any = DDS._dll_handle
_int32, _void_p, _int64, _size = ctypes.c_int32, ctypes.c_void_p, ctypes.c_int64, ctypes.c_size_t


def function(name: str, result: Any, *arguments: Any) -> Any:
    """Return a function of the C library with its types declared."""
    function = getattr(_lib, name)
    function.restype = result
    function.argtypes = arguments
    return function


_create_qos = function("dds_create_qos", _void_p)
_delete_qos = function("dds_delete_qos", None, _void_p)
_qset_userdata = function("dds_qset_userdata", None, _void_p, ctypes.c_char_p, _size)
_qset_reliability = function("dds_qset_reliability", None, _void_p, ctypes.c_int, _int64)
_qset_durability = function("dds_qset_durability", None, _void_p, ctypes.c_int)
_qset_history = function("dds_qset_history", None, _void_p, ctypes.c_int, _int32)
_qset_durability_service = function(
    "dds_qset_durability_service",
    None,
    _void_p,
    _int64,
    ctypes.c_int,
    _int32,
    _int32,
    _int32,
    _int32,
)
_qset_deadline = function("dds_qset_deadline", None, _void_p, _int64)
_qset_lifespan = function("dds_qset_lifespan", None, _void_p, _int64)
_qset_liveliness = function("dds_qset_liveliness", None, _void_p, ctypes.c_int, _int64)
_qset_ownership = function("dds_qset_ownership", None, _void_p, ctypes.c_int)
_qset_strength = function("dds_qset_ownership_strength", None, _void_p, _int32)
_qset_separation = function("dds_qset_time_based_filter", None, _void_p, _int64)
_qset_batching = function("dds_qset_writer_batching", None, _void_p, ctypes.c_bool)
_qset_partition = function(
    "dds_qset_partition", None, _void_p, ctypes.c_uint32, ctypes.POINTER(ctypes.c_char_p)
)
_create_domain = function("dds_create_domain", _int32, ctypes.c_uint32, ctypes.c_char_p)
_create_participant = function("dds_create_participant", _int32, ctypes.c_uint32, _void_p, _void_p)
_create_group = {
    kind: function(f"dds_create_{kind}", _int32, _int32, _void_p, _void_p)
    for kind in ("publisher", "subscriber")
}
_create_endpoint = {
    kind: function(f"dds_create_{kind}", _int32, _int32, _int32, _void_p, _void_p)
    for kind in ("writer", "reader")
}
_delete = function("dds_delete", _int32, _int32)
_get_guid = function("dds_get_guid", _int32, _int32, _void_p)
_get_instance_handle = function(
    "dds_get_instance_handle", _int32, _int32, ctypes.POINTER(ctypes.c_uint64)
)
_get_entity_sertype = function("dds_get_entity_sertype", _int32, _int32, ctypes.POINTER(_void_p))
_get_domainid = function("dds_get_domainid", _int32, _int32, ctypes.POINTER(ctypes.c_uint32))
_create_topic_sertype = function(
    "dds_create_topic_sertype", _int32,
    _int32, ctypes.c_char_p, ctypes.POINTER(_void_p), _void_p, _void_p, _void_p,
)  # fmt: skip
_sertype_ref = function("ddsi_sertype_ref", _void_p, _void_p)
_sertype_unref = function("ddsi_sertype_unref", None, _void_p)
_set_status_mask = function("dds_set_status_mask", _int32, _int32, ctypes.c_uint32)
_get_status_changes = function(
    "dds_get_status_changes", _int32, _int32, ctypes.POINTER(ctypes.c_uint32)
)
_take_status = function(
    "dds_take_status", _int32, _int32, ctypes.POINTER(ctypes.c_uint32), ctypes.c_uint32
)
_get_matched_publications = function(
    "dds_get_matched_publications", _int32, _int32, ctypes.POINTER(ctypes.c_uint64), _size
)
_get_matched_subscriptions = function(
    "dds_get_matched_subscriptions", _int32, _int32, ctypes.POINTER(ctypes.c_uint64), _size
)
_create_waitset = function("dds_create_waitset", _int32, _int32)
_create_guard = function("dds_create_guardcondition", _int32, _int32)
_set_guard = function("dds_set_guardcondition", _int32, _int32, ctypes.c_bool)
_waitset_attach = function("dds_waitset_attach", _int32, _int32, _int32, ctypes.c_ssize_t)
_waitset_detach = function("dds_waitset_detach", _int32, _int32, _int32)
_waitset_wait = function(
    "dds_waitset_wait", _int32, _int32, ctypes.POINTER(ctypes.c_ssize_t), _size, _int64
)
_strretcode = function("dds_strretcode", ctypes.c_char_p, _int32)

_ROOT_ENTITY: Final = 0x7FFF0100  # DDS_CYCLONEDDS_HANDLE: parent of what spans domains


def check(code: int, action: str) -> int:
    """Return a code or entity that is no error.

    Raises:
        MiddlewareError: It is an error; the text says that DDS cannot do ``action``.
    """
    if code < 0:
        raise MiddlewareError(f"DDS cannot {action}: {_strretcode(code).decode()}")
    return code


# --- entities -----------------------------------------------------------------


_domains: dict[int, tuple[int, int]] = {}  # entity, users


def open_domain(domain: int, config: str) -> None:
    """Join a domain with a configuration (XML, or what CYCLONEDDS_URI takes).

    A process has each domain once: later users share it as the first has configured it. Each call
    needs one :func:`close_domain`.
    """
    entity, users = _domains.get(domain, (0, 0))
    if not users:
        entity = check(_create_domain(domain, config.encode()), f"join domain {domain}")
    _domains[domain] = entity, users + 1


def close_domain(domain: int) -> None:
    """Leave a domain; the last user deletes all its entities."""
    entity, users = _domains.pop(domain)
    if users > 1:
        _domains[domain] = entity, users - 1
        return
    for key in [key for key in _sertypes if key[0] == domain]:
        _sertype_unref(_sertypes.pop(key))
    _delete(entity)


def create_participant(domain: int, user_data: bytes) -> int:
    """Create a participant with this USER_DATA in a domain that is open."""
    if domain not in _domains:
        raise MiddlewareError(f"domain {domain} is not open")
    qos = _create_qos()
    _qset_userdata(qos, user_data, len(user_data))
    try:
        return check(
            _create_participant(domain, qos, None), f"create a participant in domain {domain}"
        )
    finally:
        _delete_qos(qos)


def create_group(kind: str, participant: int, partitions: tuple[str, ...] = ()) -> int:
    """Create a ``publisher`` or a ``subscriber`` in these partitions."""
    qos = _create_qos()
    if partitions:
        names = (ctypes.c_char_p * len(partitions))(*[name.encode() for name in partitions])
        _qset_partition(qos, len(partitions), names)
    try:
        return check(_create_group[kind](participant, qos, None), f"create a {kind}")
    finally:
        _delete_qos(qos)


def create_writer(
    publisher: int, topic: int, qos: QoSProfile, user_data: bytes, batching: bool = False
) -> int:
    """Create a writer.

    With ``batching``, samples are held back until :func:`flush`, or until a packet is full.
    """
    return _endpoint("writer", publisher, topic, qos, user_data, batching)


def create_reader(subscriber: int, topic: int, qos: QoSProfile, user_data: bytes = b"") -> int:
    """Create a reader that wakes its waitset when samples arrive."""
    reader = _endpoint("reader", subscriber, topic, qos, user_data)
    wake_on(reader, STATUS_DATA_AVAILABLE)
    return reader


def _endpoint(
    kind: str, group: int, topic: int, qos: QoSProfile, user_data: bytes, batching: bool = False
) -> int:
    c_qos = _c_qos(qos, user_data, kind)
    if batching:
        _qset_batching(c_qos, True)
    try:
        return check(_create_endpoint[kind](group, topic, c_qos, None), f"create a data{kind}")
    finally:
        _delete_qos(c_qos)


def _c_qos(qos: QoSProfile, user_data: bytes, kind: str) -> Any:
    c_qos = _create_qos()
    # A writer never blocks: the data plane must not wait in dds_write.
    _qset_reliability(c_qos, 1 if qos.reliable else 0, 0)
    durability = {
        DurabilityPolicy.TRANSIENT_LOCAL: 1,
        DurabilityPolicy.TRANSIENT: 1,  # without a durability service the nearest to it
        DurabilityPolicy.PERSISTENT: 1,
    }.get(qos.durability, 0)
    _qset_durability(c_qos, durability)
    keep_all = qos.history == HistoryPolicy.KEEP_ALL
    depth = 0 if keep_all else max(1, qos.depth)
    _qset_history(c_qos, 1 if keep_all else 0, depth)
    if durability and kind == "writer":
        # The history for late readers: by default Cyclone keeps one sample, and all samples of a
        # writer that keeps all, without end.
        _qset_durability_service(c_qos, 0, 0, depth or MAX_PAST, -1, -1, -1)
    if qos.deadline_ms:
        _qset_deadline(c_qos, qos.deadline_ms * 1_000_000)
    if qos.lifespan_ms and kind == "writer":
        _qset_lifespan(c_qos, qos.lifespan_ms * 1_000_000)
    if qos.liveliness == LivelinessPolicy.MANUAL_BY_TOPIC or qos.liveliness_lease_ms:
        lease = qos.liveliness_lease_ms
        _qset_liveliness(
            c_qos,
            2 if qos.liveliness == LivelinessPolicy.MANUAL_BY_TOPIC else 0,
            lease * 1_000_000 if lease else INFINITE,
        )
    if qos.ownership_exclusive or qos.ownership_strength is not None:
        _qset_ownership(c_qos, 1)
        if kind == "writer":
            _qset_strength(c_qos, qos.ownership_strength or 0)
    if qos.separation_ms and kind == "reader":
        _qset_separation(c_qos, qos.separation_ms * 1_000_000)
    data = qos.user_data + user_data
    if data:
        _qset_userdata(c_qos, data, len(data))
    return c_qos


def wake_on(endpoint: int, status: int) -> None:
    """Set which status of a reader or writer wakes the waitset it is in."""
    check(_set_status_mask(endpoint, status), "watch an endpoint")


def reset(endpoint: int, status: int) -> None:
    """Reset a status, so that its next change wakes the waitset."""
    _take_status(endpoint, ctypes.byref(ctypes.c_uint32()), status)


def has_changed(endpoint: int, status: int) -> bool:
    """Return whether a status has changed since it was read or reset."""
    changes = ctypes.c_uint32()
    check(_get_status_changes(endpoint, ctypes.byref(changes)), "ask for an endpoint's status")
    return bool(changes.value & status)


def matched_writers(reader: int) -> set[int]:
    """Return the instance handles of the writers that match a reader, local ones included.

    Resets the status SUBSCRIPTION_MATCHED first, so that a change is not missed.
    """
    reset(reader, STATUS_SUBSCRIPTION_MATCHED)
    return peek_matched_writers(reader)


def peek_matched_writers(reader: int) -> set[int]:
    """Return the same without resetting that status, on which another caller may wait."""
    return _matched(_get_matched_publications, reader)


def matched_readers(writer: int) -> set[int]:
    """Return the instance handles of the readers that match a writer, local ones included."""
    return _matched(_get_matched_subscriptions, writer)


def _matched(get: Any, endpoint: int) -> set[int]:
    size = 64
    while True:
        handles = (ctypes.c_uint64 * size)()
        count: int = get(endpoint, handles, size)
        if count <= size:
            return set(handles[: max(0, count)])
        size = count


def count_readers(writer: int) -> int:
    """Return how many readers match a writer, local ones included."""
    count: int = _get_matched_subscriptions(writer, None, 0)
    return max(0, count)


def delete(entity: int) -> None:
    """Delete an entity and what it contains; idempotent."""
    _delete(entity)


def guid(entity: int) -> bytes:
    """Return the 16 octets of an entity's GUID, in the order of the network."""
    out = (ctypes.c_ubyte * 16)()
    check(_get_guid(entity, out), "get a GUID")
    return bytes(out)


def instance_handle(entity: int) -> int:
    """Return the 64-bit local instance handle of an entity."""
    out = ctypes.c_uint64()
    check(_get_instance_handle(entity, ctypes.byref(out)), "get an instance handle")
    return out.value


# --- topics without a type ------------------------------------------------------


class _Any(IdlStruct, typename="uros::Any"):
    """Stands for every type: the binding needs a class, and only its name is used."""

    # One octet: Cyclone checks and byte-swaps a sample as far as its type reaches,
    # so every sample stays as it is. Not as text: the binding resolves annotations
    # itself.
    __annotations__ = {"octet": uint8}


class _Named:
    """The attributes that the binding reads of a type, with another name."""

    def __init__(self, name: str, idl: Any) -> None:
        self.idl_transformed_typename = name
        self.data_type_props = idl.data_type_props
        self.supported_versions = idl.supported_versions
        self._xt_bytedata = idl._xt_bytedata


class _Type:
    def __init__(self, name: str) -> None:
        idl: Any = _Any.__idl__
        idl.populate()
        idl.fill_type_data()
        self.__idl__ = _Named(name, idl)


_types: dict[str, _Type] = {}
_patched_ops: dict[int, Any] = {}


# By domain and type name; each holds a reference of its own. A second sertype of a name would not
# compare equal to a patched one, and Cyclone's table cannot hold many of one name.
_sertypes: dict[tuple[int, str], int] = {}
# The most types of all domains, because a client may use one after the other. The memory of a name
# is only freed with its domain.
MAX_TYPES: Final = 4096


def _is_known(type_name: str) -> bool:
    """Return whether uros has the type itself: these are few."""
    from ...interfaces.typehash import is_known

    return is_known(type_name)


def create_topic(participant: int, name: str, type_name: str) -> int:
    """Create a topic whose type is nothing but its name.

    Raises:
        MiddlewareError: DDS refuses it, or there are too many types.
    """
    domain = ctypes.c_uint32()
    check(_get_domainid(participant, ctypes.byref(domain)), "get a domain")
    key = domain.value, type_name
    shared_sertype = _sertypes.get(key)
    topic: int
    if shared_sertype is not None:
        sertype = _void_p(_sertype_ref(shared_sertype))  # the topic's
        topic = _create_topic_sertype(
            participant, name.encode(), ctypes.byref(sertype), None, None, None
        )
        if topic < 0:
            _sertype_unref(shared_sertype)
    else:
        if len(_sertypes) >= MAX_TYPES and not _is_known(type_name):
            raise MiddlewareError(
                f"more than {MAX_TYPES} types: {type_name!r} is refused until the agent is"
                " restarted (types that uros knows are always taken)"
            )
        kind = _types.get(type_name)
        if kind is None:
            kind = _types[type_name] = _Type(type_name)
        topic = _clayer.ddspy_topic_create(participant, name, kind, None, None)
    if topic < 0:
        raise MiddlewareError(
            f"DDS refuses the topic {name!r} with the type {type_name!r}:"
            f" {_strretcode(topic).decode()}"
        )
    if shared_sertype is None:
        try:
            _sertypes[key] = _sertype_ref(_disable_type_information(topic))
        except MiddlewareError:
            delete(topic)
            raise
    return topic


def _disable_type_information(topic: int) -> int:
    """Keep a topic from announcing type information, see the module; return its sertype."""
    sertype = _void_p()
    check(_get_entity_sertype(topic, ctypes.byref(sertype)), "find a topic's sertype")
    assert sertype.value is not None
    word = ctypes.cast(sertype.value, ctypes.POINTER(_void_p))
    address = word[0]
    if address is None:
        raise MiddlewareError(_CHANGED)
    patched = _patched_ops.get(address)
    if patched is None:
        if _patched_ops or not _is_ops_table(address):
            raise MiddlewareError(_CHANGED)
        patched = (_void_p * _SERTYPE_OPS_SIZE)()
        ctypes.memmove(patched, address, ctypes.sizeof(patched))
        for index in _SERTYPE_OPS_TYPES:
            patched[index] = None
        _patched_ops[address] = patched
    word[0] = ctypes.addressof(patched)
    return sertype.value


_CHANGED = (
    "this build of cyclonedds lays out its sertypes in a way uros does not know;"
    " install the version uros is tested with: python -m pip install 'cyclonedds==11.0.1'"
)


def _is_ops_table(address: int) -> bool:
    """Return whether ``address`` is the binding's operations table.

    If the platform exports the table (Linux), its symbol is compared; elsewhere, which of
    its entries are null.
    """
    try:
        exported = ctypes.addressof(
            ctypes.c_char.in_dll(ctypes.CDLL(_clayer.__file__), "ddspy_sertype_ops")
        )
    except (OSError, ValueError):
        table = ctypes.cast(address, ctypes.POINTER(_void_p * _SERTYPE_OPS_SIZE)).contents
        return all((entry is None) == (i in _SERTYPE_OPS_EMPTY) for i, entry in enumerate(table))
    return address == exported


# --- samples --------------------------------------------------------------------

# Writes a sample whose length is a multiple of 4; returns a code, see :func:`is_written`.
write_aligned: Callable[[int, Bytes], int] = _clayer.ddspy_write
_ddspy_writedispose = _clayer.ddspy_writedispose
_ddspy_take = _clayer.ddspy_take
_ddspy_read = _clayer.ddspy_read
# Reading copies samples: of large ones no more than a few at a time.
_READ: Final = 16
_READ_LARGE: Final = 1
_LARGE: Final = 64 * 1024


def write(writer: int, cdr: Bytes) -> bool:
    """Write one sample; return False if the writer has no room and would block."""
    return is_written(write_aligned(writer, _padded(cdr) if len(cdr) & 3 else cdr))


def write_disposed(writer: int, cdr: Bytes) -> bool:
    """Write one sample with the status "disposed".

    Cyclone's readers take it as data, others as no valid sample; see
    :mod:`~uros.middleware.dds.service_peers`.
    """
    code: int = _ddspy_writedispose(writer, _padded(cdr) if len(cdr) & 3 else cdr)
    return is_written(code)


def _padded(cdr: Bytes) -> bytes:
    """Pad a sample with zeros to a multiple of 4; Cyclone would send old content of its memory."""
    fill = -len(cdr) & 3
    return bytes(cdr[:3]) + bytes((fill,)) + bytes(cdr[4:]) + bytes(fill)


def is_written(code: int) -> bool:
    """Return whether ``code`` means success; False if it means no room.

    Raises:
        MiddlewareError: It means another error.
    """
    if code == 0:
        return True
    if code in (RETCODE_TIMEOUT, RETCODE_OUT_OF_RESOURCES):
        return False
    raise MiddlewareError(f"DDS cannot write: {_strretcode(code).decode()}")


# Sends what a writer with batching holds back: one packet for many small samples.
flush = function("dds_write_flush", _int32, _int32)


def take(reader: int, limit: int) -> list[tuple[bytes, Any]]:
    """Take at most ``limit`` samples with their SampleInfo, invalid ones left out.

    Fewer mean that no more wait.
    """
    samples = _ddspy_take(reader, ANY_STATE, limit)
    if isinstance(samples, int):
        return []
    valid = [
        item if not item[0][3] & 3 else (_unpadded(item[0]), item[1])
        for item in samples
        if item[1].valid_data
    ]
    if len(valid) < len(samples) == limit:
        valid += take(reader, limit - len(valid))
    return valid


def unread(reader: int, limit: int) -> list[int]:
    """Return the octets of samples that were not read yet, at most ``limit`` of them.

    The samples stay in the reader and count as read from now on.
    """
    sizes: list[int] = []
    while len(sizes) < limit:
        at_once = _READ_LARGE if sizes and sizes[-1] > _LARGE else _READ
        samples = _ddspy_read(reader, NOT_READ, min(at_once, limit - len(sizes)))
        if isinstance(samples, int) or not samples:
            break
        sizes += [len(cdr) for cdr, _ in samples]
    return sizes


def _unpadded(cdr: bytes) -> bytes:
    """Return a sample without the padding at its end.

    The last two bits of the encapsulation options count its octets (XTypes 1.3, 7.6.3.1.2).
    """
    return cdr[:3] + b"\0" + cdr[4 : -(cdr[3] & 3)]


# --- waiting --------------------------------------------------------------------


class Waitset:
    """The readers that one thread waits for; :meth:`wait` returns their keys."""

    def __init__(self) -> None:
        self._entity = check(_create_waitset(_ROOT_ENTITY), "create a waitset")
        self._guard = check(_create_guard(_ROOT_ENTITY), "create a guard condition")
        check(_waitset_attach(self._entity, self._guard, 0), "attach a guard condition")
        self._keys = (ctypes.c_ssize_t * 256)()

    def attach(self, reader: int, key: int) -> None:
        """Wait for a reader; ``key`` is a positive number of the caller's."""
        check(_waitset_attach(self._entity, reader, key), "wait for a reader")

    def detach(self, reader: int) -> None:
        """Wait for a reader no more."""
        _waitset_detach(self._entity, reader)

    def wait(self) -> list[int]:
        """Sleep without the GIL until something arrives or :meth:`wake`; return the keys."""
        count = _waitset_wait(self._entity, self._keys, len(self._keys), INFINITE)
        _set_guard(self._guard, False)
        return [key for key in self._keys[: max(0, min(count, len(self._keys)))] if key]

    def wake(self) -> None:
        """Make the current or next :meth:`wait` return; thread-safe."""
        _set_guard(self._guard, True)

    def close(self) -> None:
        """Delete the waitset, which no thread may be waiting in."""
        delete(self._guard)
        delete(self._entity)
