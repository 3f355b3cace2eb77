"""Quality of service: one profile class for boards, agent and host.

Names and values follow rclpy (``rmw/types.h``); times are integer
milliseconds, None or 0 meaning unlimited. Runs on MicroPython.
"""

from .wire import ids

try:
    from typing import Final
except ImportError:  # MicroPython
    pass

# Whether profiles compare by their fields and print them. A board's build says False.
COMPARABLE: Final = True


class HistoryPolicy:
    """Which samples a writer or reader keeps."""

    SYSTEM_DEFAULT = 0
    KEEP_LAST = 1
    KEEP_ALL = 2


class ReliabilityPolicy:
    """Whether lost samples are sent again."""

    SYSTEM_DEFAULT = 0
    RELIABLE = 1
    BEST_EFFORT = 2


class DurabilityPolicy:
    """Whether late readers get samples that were written before."""

    SYSTEM_DEFAULT = 0
    TRANSIENT_LOCAL = 1
    VOLATILE = 2
    TRANSIENT = 5
    PERSISTENT = 6


class LivelinessPolicy:
    """How a writer asserts that it is alive."""

    SYSTEM_DEFAULT = 0
    AUTOMATIC = 1
    MANUAL_BY_TOPIC = 3


class QoSProfile:
    """A QoS profile. ``depth`` applies to KEEP_LAST only.

    ``separation_ms`` is a reader's minimum time between samples,
    ``ownership_strength`` a writer's (None: shared ownership); ``partitions``
    are DDS partitions.
    """

    __slots__ = (
        "deadline_ms",
        "depth",
        "durability",
        "history",
        "lifespan_ms",
        "liveliness",
        "liveliness_lease_ms",
        "ownership_exclusive",
        "ownership_strength",
        "partitions",
        "reliability",
        "separation_ms",
        "user_data",
    )

    def __init__(
        self,
        depth: int = 10,
        reliability: int = ReliabilityPolicy.RELIABLE,
        durability: int = DurabilityPolicy.VOLATILE,
        history: int = HistoryPolicy.KEEP_LAST,
        deadline_ms: "int | None" = None,
        lifespan_ms: "int | None" = None,
        liveliness: int = LivelinessPolicy.AUTOMATIC,
        liveliness_lease_ms: "int | None" = None,
        ownership_exclusive: bool = False,
        ownership_strength: "int | None" = None,
        separation_ms: "int | None" = None,
        partitions: "tuple[str, ...]" = (),
        user_data: bytes = b"",
    ) -> None:
        self.depth = depth
        self.reliability = reliability
        self.durability = durability
        self.history = history
        self.deadline_ms = deadline_ms
        self.lifespan_ms = lifespan_ms
        self.liveliness = liveliness
        self.liveliness_lease_ms = liveliness_lease_ms
        self.ownership_exclusive = ownership_exclusive
        self.ownership_strength = ownership_strength
        self.separation_ms = separation_ms
        self.partitions = partitions
        self.user_data = user_data

    @property
    def reliable(self) -> bool:
        """Whether the reliability is RELIABLE."""
        return self.reliability == ReliabilityPolicy.RELIABLE

    @property
    def transient_local(self) -> bool:
        """Whether late readers get earlier samples (TRANSIENT_LOCAL or stronger)."""
        return self.durability not in (
            DurabilityPolicy.VOLATILE,
            DurabilityPolicy.SYSTEM_DEFAULT,
        )

    if COMPARABLE:

        def _key(self) -> "tuple[object, ...]":
            return tuple([getattr(self, name) for name in _FIELDS])

        def __eq__(self, other: object) -> bool:
            return isinstance(other, QoSProfile) and self._key() == other._key()

        def __hash__(self) -> int:
            return hash(self._key())

        def __repr__(self) -> str:
            fields = [name + "=" + repr(getattr(self, name)) for name in _FIELDS]
            return "QoSProfile(" + ", ".join(fields) + ")"


_FIELDS = (
    "history",
    "depth",
    "reliability",
    "durability",
    "deadline_ms",
    "lifespan_ms",
    "liveliness",
    "liveliness_lease_ms",
    "ownership_exclusive",
    "ownership_strength",
    "separation_ms",
    "partitions",
    "user_data",
)


def default_profile() -> QoSProfile:
    """Return rmw_qos_profile_default: reliable, volatile, the last 10."""
    return QoSProfile()


def sensor_data_profile() -> QoSProfile:
    """Return rmw_qos_profile_sensor_data: best effort, volatile, the last 5."""
    return QoSProfile(5, ReliabilityPolicy.BEST_EFFORT)


def services_profile() -> QoSProfile:
    """Return rmw_qos_profile_services_default, which equals the default."""
    return QoSProfile()


# As rclpy has them. They are shared: make a profile of your own where one is to be changed.
qos_profile_default = QoSProfile()
qos_profile_sensor_data = sensor_data_profile()
qos_profile_services_default = QoSProfile()
qos_profile_parameters = QoSProfile(1000)
qos_profile_parameter_events = QoSProfile(1000)
qos_profile_rosout_default = QoSProfile(
    1000, durability=DurabilityPolicy.TRANSIENT_LOCAL, lifespan_ms=10000
)
qos_profile_action_status_default = QoSProfile(1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
qos_profile_system_default = QoSProfile(0, 0, 0, 0, liveliness=0)


def to_flags(qos: QoSProfile, kind: int = 0) -> int:
    """Return the QoS flags of XRCE's binary representation (7.7.9.5).

    System default is the default of DDS: a writer is reliable, a reader is not, both are volatile
    and keep the last.

    Args:
        qos: The profile.
        kind: Kind of the object (``KIND_DATAWRITER`` ...), to check the profile for it.

    Raises:
        ValueError: The binary representation cannot express the profile for that kind.
    """
    if kind:
        fault = _fault(qos, kind)
        if fault:
            raise ValueError("no agent can be asked for " + fault + _remedy(fault, qos))
    flags = 0
    reliability = qos.reliability
    if reliability == ReliabilityPolicy.RELIABLE or (
        reliability == ReliabilityPolicy.SYSTEM_DEFAULT and kind != ids.KIND_DATAREADER
    ):
        flags |= ids.QOS_RELIABLE
    if qos.history != HistoryPolicy.KEEP_ALL:
        flags |= ids.QOS_KEEP_LAST
    if qos.ownership_exclusive:
        flags |= ids.QOS_OWNERSHIP_EXCLUSIVE
    if qos.durability == DurabilityPolicy.TRANSIENT_LOCAL:
        flags |= ids.QOS_TRANSIENT_LOCAL
    elif qos.durability == DurabilityPolicy.TRANSIENT:
        flags |= ids.QOS_TRANSIENT
    elif qos.durability == DurabilityPolicy.PERSISTENT:
        flags |= ids.QOS_PERSISTENT
    return flags


def _fault(qos: QoSProfile, kind: int) -> str:
    """Name the policy that the binary representation cannot express; "" if there is none."""
    service = kind > ids.KIND_DATAREADER
    if qos.reliability not in (0, 1, 2):
        return "that reliability"
    if qos.durability not in ((0, 2) if service else (0, 1, 2, 5, 6)):
        return "that durability"
    if qos.history not in (0, 1, 2):
        return "that history"
    if qos.liveliness not in (0, 1) or qos.liveliness_lease_ms:
        return "that liveliness"
    if not 0 <= qos.depth <= 0xFFFF:
        return "that depth"
    for ms in (qos.deadline_ms, qos.lifespan_ms):
        if ms and (service or not 0 < ms <= 0xFFFFFFFF):
            return "that deadline or lifespan"
    if (
        qos.separation_ms or qos.partitions or qos.user_data
        or qos.ownership_strength is not None or (service and qos.ownership_exclusive)
    ):  # fmt: skip
        return "partitions, separation, ownership strength or user data"
    return ""


if COMPARABLE:
    _SAY = {
        "that reliability": "; give RELIABLE or BEST_EFFORT",
        "that durability": "; give VOLATILE or TRANSIENT_LOCAL, and VOLATILE for a service",
        "that history": "; give KEEP_LAST or KEEP_ALL",
        "that liveliness": "; give AUTOMATIC and no lease: the agent sees to it",
        "that depth": "; give 0 to 65535",
        "that deadline or lifespan": "; give None or 1 to 4294967295, and None for a service",
    }

    def _remedy(fault: str, qos: QoSProfile) -> str:
        """Return the remedy for a fault, and the profile."""
        return f"{_SAY.get(fault, '; leave them to hosts and to clients of XML')}: {qos!r}"

else:

    def _remedy(fault: str, qos: QoSProfile) -> str:
        return ""


def from_flags(flags: int, depth: "int | None") -> QoSProfile:
    """Return the profile of binary QoS flags and an optional depth."""
    qos = QoSProfile()
    if not flags & ids.QOS_RELIABLE:
        qos.reliability = ReliabilityPolicy.BEST_EFFORT
    if not flags & ids.QOS_KEEP_LAST:
        qos.history = HistoryPolicy.KEEP_ALL
    if flags & ids.QOS_TRANSIENT_LOCAL:
        qos.durability = DurabilityPolicy.TRANSIENT_LOCAL
    elif flags & ids.QOS_TRANSIENT:
        qos.durability = DurabilityPolicy.TRANSIENT
    elif flags & ids.QOS_PERSISTENT:
        qos.durability = DurabilityPolicy.PERSISTENT
    qos.ownership_exclusive = bool(flags & ids.QOS_OWNERSHIP_EXCLUSIVE)
    qos.depth = depth or 1
    return qos
