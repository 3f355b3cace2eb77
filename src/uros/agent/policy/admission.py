"""Admission: which client keys and networks are allowed, how many clients; refused clients.

The lists come from the table ``[admission]`` of rule files (:mod:`.rules`) and from the command
line, and are joined::

    [admission]
    keys = ["0x4B0CBE99", 7]
    networks = ["192.168.1.0/24", "fd00::/8"]
    max_clients = 20

An empty list allows all. Networks apply to IP transports only: a serial line has none.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from ipaddress import IPv4Network, IPv6Address, IPv6Network, ip_address, ip_network
from typing import Any, Final, NamedTuple

from .config_values import ConfigError, Faults, key_of, listed, only, shown, typed, whole

# The most clients, because a program may send CREATE_CLIENT with one key after the other. See
# .eviction for the clients that are evicted then.
MAX_CLIENTS: Final = 4096
# The most refused keys that are recorded, the latest ones, for the same reason.
MAX_REFUSALS: Final = 256
# Reasons of refusals; the tools show these texts.
KEY_IN_USE: Final = "client key in use"
KEY_NOT_ALLOWED: Final = "client key not allowed"
ADDRESS_NOT_ALLOWED: Final = "address not allowed"
# The most addresses for which the result is cached, because packets may have forged addresses.
_MAX_HOSTS: Final = 1024


@dataclass
class Admission:
    """The clients that an agent admits.

    Attributes:
        keys: Allowed client keys; empty for all.
        networks: Allowed IP networks; empty for all.
        max_clients: The most clients at a time.
    """

    keys: frozenset[int] = frozenset()
    networks: tuple[IPv4Network | IPv6Network, ...] = ()
    max_clients: int = MAX_CLIENTS
    _hosts: dict[str, bool] = field(default_factory=dict, repr=False, compare=False)

    def admits_key(self, key: int) -> bool:
        """Return whether a client key is allowed."""
        return not self.keys or key in self.keys

    def admits_host(self, host: str | None) -> bool:
        """Return whether an address is allowed.

        Args:
            host: A numeric IP address as sockets give it, anything else is refused; None for a
                client on a line, which has no address.
        """
        if not self.networks or host is None:
            return True
        admitted = self._hosts.get(host)
        if admitted is None:
            admitted = self._is_inside(host)
            if len(self._hosts) >= _MAX_HOSTS:
                self._hosts.clear()
            self._hosts[host] = admitted
        return admitted

    def admits(self, key: int, host: str | None) -> bool:
        """Return whether key and address are allowed."""
        return self.admits_key(key) and self.admits_host(host)

    def _is_inside(self, host: str) -> bool:
        try:
            address = ip_address(host.partition("%")[0])
        except ValueError:
            return False
        if isinstance(address, IPv6Address) and address.ipv4_mapped is not None:
            address = address.ipv4_mapped
        return any(address in network for network in self.networks)


def make_admission(
    tables: Iterable[tuple[str, Any]] = (),
    keys: Sequence[str] = (),
    networks: Sequence[str] = (),
    max_clients: int | None = None,
) -> Admission:
    """Make the admission of an agent.

    Args:
        tables: ``(file name, table)`` of rule files.
        keys: Client keys of the command line.
        networks: Networks of the command line.
        max_clients: Number of the command line; it overrides that of the files.

    Raises:
        ConfigError: Values are invalid; the texts say where.
    """
    admission = Admission()
    faults = Faults()
    for name, table in tables:
        with faults.at(about=f"{name}: [admission]"):
            _add(admission, _table(table))
    given: dict[str, Any] = {}
    if keys:
        given["keys"] = [typed(key) for key in keys]
    if networks:
        given["networks"] = list(networks)
    if max_clients is not None:
        given["max_clients"] = max_clients
    with faults.at():
        _add(admission, given)
    faults.check()
    return admission


def _add(admission: Admission, table: Mapping[str, Any]) -> None:
    faults = Faults()
    with faults.at():
        only(table, ("keys", "networks", "max_clients"), "it")
    for name in ("keys", "networks"):
        if name in table and not listed(table[name]):
            empty = f"{name} is empty, which admits nobody: leave it out to admit all"
            faults.append(ConfigError(empty, name))
    for key in listed(table.get("keys", [])):
        with faults.at("keys"):
            admission.keys |= {key_of(key)}
    for network in listed(table.get("networks", [])):
        with faults.at("networks"):
            admission.networks += (_network(network),)
    if "max_clients" in table:
        with faults.at("max_clients"):
            admission.max_clients = whole(table["max_clients"], "max_clients", 1, MAX_CLIENTS)
    faults.check()


def _table(value: Any) -> Mapping[str, Any]:
    if not isinstance(value, dict):
        raise ConfigError("it is a table, with one bracket on each side")
    return value


def _network(value: Any) -> IPv4Network | IPv6Network:
    if isinstance(value, str):
        try:
            return ip_network(value, strict=False)
        except ValueError:
            pass
    example = '"192.168.1.0/24" or "fd00::/8"'
    raise ConfigError(f"networks: {shown(value)} is no network, such as {example}")


# --- refusals -----------------------------------------------------------------------


class Refusal(NamedTuple):
    """The last refusal of a key for one reason.

    Attributes:
        why: The reason.
        address: The address that used the key.
        times: How many times it was refused for this reason.
        when: Seconds of the monotonic clock.
    """

    why: str
    address: str
    times: int
    when: float


class RefusalEvent(NamedTuple):
    """Something that was refused, for those who count or record refusals.

    Attributes:
        kind: ``board`` (a session), ``request`` (an object of a board) or ``connection``.
        rule: Which rule refused it, such as ``allow_key``.
        key: The client key; 0 if it is unknown.
        address: Where it came from.
        why: The reason, for people.
        times: How often.
    """

    kind: str
    rule: str
    key: int
    address: str
    why: str
    times: int


class LatestRefusal(NamedTuple):
    """The latest refusal of one kind by one rule.

    Attributes:
        address: Where it came from.
        why: The reason, for people.
        when: Seconds of the monotonic clock.
    """

    address: str
    why: str
    when: float


# The rules that refuse boards, by the beginning of the reason.
_RULES: Final = (
    (KEY_IN_USE, "key_in_use"), (KEY_NOT_ALLOWED, "allow_key"), (ADDRESS_NOT_ALLOWED, "allow_net"),
    ("over ", "max_clients"), ("memory", "max_memory"), ("", "protocol"),
)  # fmt: skip
# All rules, by the kind of what they refuse. Those of requests are the status names of DDS-XRCE.
RULES: Final = {
    "board": tuple(rule for _start, rule in _RULES),
    "connection": ("allow_net", "connections", "tls"),
    "request": (
        "denied", "resources", "invalid_data", "unknown_reference", "already_exists", "dds_error",
    ),
}  # fmt: skip


def rule_of(why: str) -> str:
    """Return the rule that refuses a board for a reason."""
    return next(rule for start, rule in _RULES if why.startswith(start))


class Refusals(dict[int, Refusal]):
    """Refusals by client key, the latest last; the oldest is dropped at MAX_REFUSALS.

    Attributes:
        counts: How many refusals there were, by kind and rule.
        latest: The latest one, by kind and rule.
        listeners: Called with each refusal.
    """

    def __init__(self) -> None:
        super().__init__()
        self.counts: Counter[tuple[str, str]] = Counter()
        self.latest: dict[tuple[str, str], LatestRefusal] = {}
        self.listeners: list[Callable[[RefusalEvent], None]] = []

    def count(
        self, kind: str, rule: str, address: str, why: str, when: float, key: int = 0,
        times: int = 1,
    ) -> None:  # fmt: skip
        """Count something that was refused, and tell the listeners."""
        self.counts[kind, rule] += times
        self.latest[kind, rule] = LatestRefusal(address, why, when)
        for listener in self.listeners:
            listener(RefusalEvent(kind, rule, key, address, why, times))

    def note(self, key: int, why: str, address: str, when: float, times: int = 1) -> None:
        """Record a refusal of a board, or ``times`` of them."""
        self.count("board", rule_of(why), address, why, when, key, times)
        before = self.pop(key, None)
        if before is not None and before.why == why:
            times += before.times
        elif before is None and len(self) >= MAX_REFUSALS:
            del self[next(iter(self))]
        self[key] = Refusal(why, address, times, when)
