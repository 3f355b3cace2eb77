"""Who may come in: keys, networks, how many; and a record of those who were refused.

The lists come from the table ``[admission]`` of files of rules (:mod:`.control`) and
from the command line, and add up::

    [admission]
    keys = ["0x4B0CBE99", 7]
    networks = ["192.168.1.0/24", "fd00::/8"]
    max_clients = 20

An empty list lets all in. Networks are for what comes over IP: a serial line has none.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from ipaddress import IPv4Network, IPv6Address, IPv6Network, ip_address, ip_network
from typing import Any, Final, NamedTuple

from .config_values import ConfigError, key_of, listed, only, shown, typed, whole

# Attack: CREATE_CLIENT with one key after the other. See .shares for who leaves then.
MAX_CLIENTS: Final = 4096
# Attack: the same with keys that are refused. So many are remembered, the latest.
MAX_REFUSALS: Final = 256
# Why somebody is refused. These are what the owner's tools know it by, too.
KEY_IN_USE: Final = "client key in use"
KEY_NOT_ALLOWED: Final = "client key not allowed"
ADDRESS_NOT_ALLOWED: Final = "address not allowed"
# Attack: packets in the name of all addresses. Answers for so many are remembered.
_MAX_HOSTS: Final = 1024


@dataclass
class Admission:
    """See the module."""

    keys: frozenset[int] = frozenset()
    networks: tuple[IPv4Network | IPv6Network, ...] = ()
    max_clients: int = MAX_CLIENTS
    _hosts: dict[str, bool] = field(default_factory=dict, repr=False, compare=False)

    def admits_key(self, key: int) -> bool:
        return not self.keys or key in self.keys

    def admits_host(self, host: str | None) -> bool:
        """``host`` is an IP address in numbers, as sockets give it; what is none stays out.
        None: somebody on a line, which is no network.
        """
        if not self.networks or host is None:
            return True
        known = self._hosts.get(host)
        if known is None:
            known = self._is_inside(host)
            if len(self._hosts) >= _MAX_HOSTS:
                self._hosts.clear()
            self._hosts[host] = known
        return known

    def admits(self, key: int, host: str | None) -> bool:
        return self.admits_key(key) and self.admits_host(host)

    def _is_inside(self, host: str) -> bool:
        try:
            address = ip_address(host.partition("%")[0])
        except ValueError:
            return False
        if isinstance(address, IPv6Address) and address.ipv4_mapped is not None:
            address = address.ipv4_mapped
        return any(address in it for it in self.networks)


def make_admission(
    tables: Iterable[tuple[str, Any]] = (),
    keys: Sequence[str] = (),
    networks: Sequence[str] = (),
    max_clients: int | None = None,
) -> Admission:
    """Of the files' ``(name, table)`` and of the command line, whose number goes before theirs.

    Raises ConfigError saying where a mistake is.
    """
    made = Admission()
    for name, table in tables:
        try:
            _add(made, _table(table))
        except ConfigError as error:
            raise ConfigError(f"{name}: [admission]: {error}") from error
    if keys:
        _add(made, {"keys": [typed(it) for it in keys]})
    if networks:
        _add(made, {"networks": list(networks)})
    if max_clients is not None:
        _add(made, {"max_clients": max_clients})
    return made


def _add(made: Admission, table: Mapping[str, Any]) -> None:
    only(table, ("keys", "networks", "max_clients"), "it")
    for name in ("keys", "networks"):
        if name in table and not listed(table[name]):
            raise ConfigError(f"{name} is empty, which would let nobody in: leave it out for all")
    made.keys |= {key_of(it) for it in listed(table.get("keys", []))}
    made.networks += tuple(_network(it) for it in listed(table.get("networks", [])))
    if "max_clients" in table:
        made.max_clients = whole(table["max_clients"], "max_clients", 1, MAX_CLIENTS)


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
    raise ConfigError(f'{shown(value)} is no network, such as "192.168.1.0/24" or "fd00::/8"')


# --- the refused --------------------------------------------------------------------


class Refusal(NamedTuple):
    """The last time that a key was refused for this reason, and how many times it was."""

    why: str
    address: str
    times: int
    when: float  # of time.monotonic


class Refusals(dict[int, Refusal]):
    """By client key, the latest last."""

    def note(self, key: int, why: str, address: str, when: float, times: int = 1) -> None:
        """Remember one more, or as many as ``times``; the oldest goes where there are many."""
        before = self.pop(key, None)
        if before is not None and before.why == why:
            times += before.times
        elif before is None and len(self) >= MAX_REFUSALS:
            del self[next(iter(self))]
        self[key] = Refusal(why, address, times, when)
