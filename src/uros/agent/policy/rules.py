"""Rules of the agent's owner for clients: names, domain, QoS, limits.

Rules come from a TOML file and from the command line. A rule says which
clients it is for (by key, address, name of the node; every client if it
says nothing) and what happens to them. All that match apply in their order,
and what comes later wins::

    [[client]]
    node = "/turtle_*"
    namespace = "/hall"

    [[client]]
    key = "0x4B0CBE99"
    remap = { "/cmd_vel" = "/turtle1/cmd_vel" }
    max_rate = 100
    qos."/odom" = { reliability = "best_effort", depth = 1 }

Names are ROS names, whatever prefix they have in DDS (``rt/``, ``rq/``, ``rr/`` and those that are
reserved): a plain datawriter on one half of a service obeys what holds for the service. A name with
such a prefix that ROS does not allow is refused. A name without one stays as it is, unless the
rules put the board into a namespace: then it is refused, because it cannot be in a namespace.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from ipaddress import ip_address, ip_network
from pathlib import Path
from typing import Any, Final, TypeVar

from ... import names
from ...middleware.base import MAX_DOMAIN, Service
from ...qos import (
    DurabilityPolicy,
    HistoryPolicy,
    LivelinessPolicy,
    QoSProfile,
    ReliabilityPolicy,
)
from ...token_bucket import TokenBucket
from ..clock import Clock
from .config_values import ConfigError as ConfigError
from .config_values import Faults, faults_of, key_of, listed, only, shown, table_of, whole
from .toml_file import TomlFile

_Value = TypeVar("_Value")

# Names that are global in ROS: a namespace does not apply to them, remapping does.
GLOBAL: Final = frozenset(
    {
        "/clock",
        "/diagnostics",
        "/parameter_events",
        "/ros_to_microros_graph",
        "/rosout",
        "/tf",
        "/tf_static",
    }
)
# Messages that may come at once under max_rate, as seconds of that rate.
_BURST: Final = 0.25
_MAX_MS: Final = 0x7FFFFFFF
_MAX_DEPTH: Final = 1_000_000

_POLICIES: Final[dict[str, dict[str, int]]] = {
    "reliability": {
        "reliable": ReliabilityPolicy.RELIABLE,
        "best_effort": ReliabilityPolicy.BEST_EFFORT,
    },
    "durability": {
        "volatile": DurabilityPolicy.VOLATILE,
        "transient_local": DurabilityPolicy.TRANSIENT_LOCAL,
    },
    "history": {"keep_last": HistoryPolicy.KEEP_LAST, "keep_all": HistoryPolicy.KEEP_ALL},
    "liveliness": {
        "automatic": LivelinessPolicy.AUTOMATIC,
        "manual_by_topic": LivelinessPolicy.MANUAL_BY_TOPIC,
    },
}
_NUMBERS: Final = {
    "depth": (1, _MAX_DEPTH),
    "deadline_ms": (1, _MAX_MS),
    "lifespan_ms": (1, _MAX_MS),
    "liveliness_lease_ms": (1, _MAX_MS),
}
_SELECTORS: Final = ("key", "address", "node")
_ACTIONS: Final = ("domain", "namespace", "remap", "qos", "max_rate", "max_size")


@dataclass
class Rule:
    """One rule; None and empty fields do not apply."""

    keys: frozenset[int] = frozenset()
    addresses: tuple[str, ...] = ()
    nodes: tuple[str, ...] = ()
    domain: int | None = None
    namespace: str | None = None
    remap: dict[str, str] = field(default_factory=dict)
    qos: dict[str, dict[str, int]] = field(default_factory=dict)  # by patterns of topics
    max_rate: float | None = None
    max_size: int | None = None

    def is_for(self, key: int, address: str) -> bool:
        """Return whether the rule applies to some node of a client."""
        if self.keys and key not in self.keys:
            return False
        return not self.addresses or any(_is_at(address, pattern) for pattern in self.addresses)

    def matches(self, key: int, address: str, node: str) -> bool:
        """Return whether it applies; ``address`` as in the log, ``node`` as the board names it."""
        if not self.is_for(key, address):
            return False
        return not self.nodes or any(fnmatchcase(node, pattern) for pattern in self.nodes)


class NameRefused(Exception):
    """A topic, service or node may not have this name; the text has the reason and the remedy."""


class Limiter:
    """``max_rate`` and ``max_size`` of one node, which all its writers share.

    Args:
        max_rate: Messages a second; None: no limit.
        max_size: Bytes of a message; None: no limit.
        clock: The time in seconds.
    """

    __slots__ = ("_clock", "_max_size", "_rate")

    def __init__(
        self, max_rate: float | None, max_size: int | None, clock: Callable[[], float]
    ) -> None:
        self._max_size = max_size
        self._clock = clock
        self._rate: TokenBucket | None = None
        if max_rate is not None:
            self._rate = TokenBucket(max(1.0, max_rate * _BURST), max_rate)
            self._rate.available(clock())

    def admits(self) -> bool:
        """Return whether one more message may pass now under max_rate, and count it."""
        return self._rate is None or self._rate.take(self._clock())

    def write(
        self,
        sample: memoryview,
        write: Callable[[memoryview], bool],
        on_too_large: Callable[[str], None],
    ) -> bool:
        """Hand ``sample`` to ``write`` within the limits.

        Args:
            sample: The message.
            write: Takes the message; False: it has no room now.
            on_too_large: Called with the reason when the message is dropped for its size.

        Returns:
            False if the rate or ``write`` does not allow it now: the message must come again.
        """
        if self._max_size is not None and len(sample) > self._max_size:
            on_too_large(f"{len(sample)} bytes are over max_size {self._max_size}")
            return True
        if not self.admits():
            return False
        if write(sample):
            return True
        if self._rate is not None:
            self._rate.put_back()  # the caller gives the message again
        return False


class Settings:
    """The rules that apply to one node of one client, combined."""

    def __init__(self, rules: list[Rule], clock: Callable[[], float] | None = None) -> None:
        self.any_name = False  # see Middleware.any_name; in a namespace they are ROS's all the same
        self.domain: int | None = None
        self.namespace = ""
        self._remap: dict[str, str] = {}
        self._qos: list[tuple[str, dict[str, int]]] = []
        self.max_size: int | None = None
        self.max_rate: float | None = None
        for rule in rules:
            self.domain = self.domain if rule.domain is None else rule.domain
            self.namespace = self.namespace if rule.namespace is None else rule.namespace
            self._remap.update(rule.remap)
            self._qos.extend(rule.qos.items())
            self.max_size = self.max_size if rule.max_size is None else rule.max_size
            self.max_rate = self.max_rate if rule.max_rate is None else rule.max_rate
        self.limiter = (
            None
            if self.max_rate is None and self.max_size is None
            else Limiter(self.max_rate, self.max_size, clock or Clock().monotonic)
        )

    # --- names ------------------------------------------------------------------

    @property
    def remapped(self) -> frozenset[str]:
        """The targets of remappings, which get no namespace."""
        return frozenset(self._remap.values())

    def node(self, namespace: str, name: str) -> tuple[str, str]:
        """Map namespace and name of a node; raises NameRefused."""
        whole = (self.namespace + namespace).rstrip("/") or "/"
        why = "" if whole == "/" else names.fault(whole, names.MAX_NAMESPACE)
        if not why and len(name) > names.MAX_NODE_NAME:
            why = f"the name has {len(name)} characters, and {names.MAX_NODE_NAME} are the most"
        if why and (self.namespace or not self.any_name):
            raise NameRefused(f"node {_cut(names.join(whole, name))!a}: {why}")
        return whole, name

    def name(self, name: str, prefix: str = "rt") -> str:
        """Map the name of a topic or service that the board uses.

        ``prefix`` is that of DDS: a service with the name of a topic of :data:`GLOBAL` is put into
        the namespace.
        """
        to = self._remap.get(name)
        if to is None:
            to = name if prefix == "rt" and name in GLOBAL else self.namespace + name
        return to

    def topic(self, dds_name: str) -> str:
        """Map the DDS name of a topic, or of one half of a service, that the board uses.

        Raises NameRefused for what ROS does not allow after its prefixes, and for what is no name
        of ROS if the board is in a namespace.
        """
        parts = names.split_dds(dds_name)
        free = self.any_name and not self.namespace
        if free and (parts is None or names.fault(parts[1])):
            return self._remap.get(dds_name, dds_name)
        if parts is None:
            if self.namespace:
                raise NameRefused(
                    f"topic {_cut(dds_name)!a} is no name of ROS (rt/…), and a rule puts this board"
                    f" into the namespace {self.namespace}: name it rt/…, or take the board out of"
                    " the rule"
                )
            if not 0 < len(dds_name) <= names.MAX_DDS_NAME:
                raise NameRefused(
                    f"topic {_cut(dds_name)!a}: it has {len(dds_name)} characters, and DDS has 1 to"
                    f" {names.MAX_DDS_NAME}"
                )
            return dds_name
        prefix, ros_name, suffix = parts
        why = names.fault(ros_name)
        if why:
            raise NameRefused(f"topic {_cut(dds_name)!a} is refused by the rules of ROS: {why}")
        name = self.name(ros_name, prefix)
        why = names.fault(name)
        if why:
            raise NameRefused(
                f"topic {_cut(dds_name)!a} would be {_cut(name)!a} by the agent's rules: {why}"
            )
        return f"{prefix}{name}{suffix}"

    def service(self, service: Service) -> Service:
        """Map the two topics of a service; raises NameRefused."""
        return Service(
            self.topic(service.request_topic),
            service.request_type,
            self.topic(service.reply_topic),
            service.reply_type,
        )

    # --- QoS ------------------------------------------------------------

    def apply(self, qos: QoSProfile, dds_name: str) -> None:
        """Apply the QoS rules for the topic that the board calls ``dds_name``."""
        prefix, ros_name, _ = names.split_dds(dds_name) or ("", names.absolute(dds_name), "")
        called = {ros_name, self.name(ros_name, prefix)}
        for pattern, fields in self._qos:
            if any(fnmatchcase(called_name, pattern) for called_name in called):
                for key, value in fields.items():
                    setattr(qos, key, value)


# The settings if no rule applies.
NOTHING: Final = Settings([])


class Rules:
    """All rules of an agent, in order."""

    def __init__(self) -> None:
        self._rules: list[Rule] = []
        # The tables [admission] of files, by name, as they are: see .admission.
        self.admission: list[tuple[str, Any]] = []

    def load(self, path: str | Path) -> int:
        """Add the rules of a file; return how many. Raises ConfigError with the file's name.

        Its table ``[admission]`` is added even if rules are wrong, so that both can be checked.
        """
        document = TomlFile(path).content
        if "admission" in document:
            self.admission.append((str(path), document["admission"]))
        before = len(self._rules)
        with faults_of(str(path)):
            self._rules.extend(_rules(document))
        return len(self._rules) - before

    def add(self, table: Mapping[str, Any]) -> None:
        """Add one rule from a ``[[client]]`` table; raises ConfigError."""
        self._rules.append(parse_rule(table))

    def settings(
        self, key: int, address: str, node: str, clock: Callable[[], float] | None = None
    ) -> Settings:
        """Return the settings of a node of a client; see :meth:`Rule.matches`."""
        rules = [rule for rule in self._rules if rule.matches(key, address, node)]
        return Settings(rules, clock) if rules else NOTHING

    def matching(self, key: int, address: str) -> list[Rule]:
        """Return the rules that apply to some node of a client, in order."""
        return [rule for rule in self._rules if rule.is_for(key, address)]

    def same_rules(self, key: int, address: str, other_address: str) -> bool:
        """Return whether a client has the same rules at two addresses, for all node names."""
        return address == other_address or all(
            rule.is_for(key, address) == rule.is_for(key, other_address) for rule in self._rules
        )


def _cut(name: str) -> str:
    """Cut a refused name for the log."""
    return name if len(name) <= 80 else name[:80] + "…"


def _is_at(address: str, pattern: str) -> bool:
    where = re.sub(r" \(CN=[^()]*\)$", "", address)  # of a TLS client, whose name may be matched
    host = re.sub(r":[0-9]+$| \([0-9]+\)$", "", where).strip("[]")
    try:
        return ip_address(host) in ip_network(pattern, strict=False)
    except ValueError:
        return any(fnmatchcase(candidate, pattern) for candidate in (address, where, host))


# --- from TOML ----------------------------------------------------------------------


def _rules(document: Mapping[str, Any]) -> list[Rule]:
    faults = Faults()
    with faults.at():
        only(document, ("client", "admission"), "the file")
    tables = document.get("client", [])
    if not isinstance(tables, list) or not all(isinstance(table, dict) for table in tables):
        faults.append(ConfigError("rules are [[client]] tables, with two brackets", "client"))
        tables = []
    elif not tables and "admission" not in document and not faults:
        faults.append(ConfigError("there is no [[client]] table in it, and no [admission]"))
    rules = []
    for index, table in enumerate(tables):
        with faults.at("client", index, about=f"[[client]] number {index + 1}"):
            rules.append(parse_rule(table))
    faults.check()
    return rules


def parse_rule(table: Mapping[str, Any]) -> Rule:
    """Parse a rule from a ``[[client]]`` table; raises ConfigError with all its faults."""
    faults = Faults()
    with faults.at():
        only(table, _SELECTORS + _ACTIONS, "a rule")
        if not any(key in table for key in _ACTIONS):
            raise ConfigError(f"it does nothing; it may have {', '.join(_ACTIONS)}")
    rule = Rule(
        keys=frozenset(_each(table, "key", key_of, faults)),
        addresses=tuple(_each(table, "address", _address, faults)),
        nodes=tuple(_each(table, "node", _node, faults)),
    )
    if "domain" in table:
        with faults.at("domain"):
            rule.domain = whole(table["domain"], "domain", 0, MAX_DOMAIN)
    if "namespace" in table:
        with faults.at("namespace"):
            rule.namespace = _namespace(table["namespace"])
    with faults.at("remap"):
        rule.remap = _remap(table_of(table.get("remap", {}), "remap"))
    with faults.at("qos"):
        rule.qos = _qos(table_of(table.get("qos", {}), "qos"))
    if "max_rate" in table:
        with faults.at("max_rate"):
            rule.max_rate = _rate(table["max_rate"])
    if "max_size" in table:
        with faults.at("max_size"):
            rule.max_size = whole(table["max_size"], "max_size", 1, _MAX_MS)
    faults.check()
    return rule


def _each(
    table: Mapping[str, Any], name: str, parse: Callable[[Any], _Value], faults: Faults
) -> list[_Value]:
    """Return the valid ones of a key's values, one or a list; collect the faults of others."""
    values = []
    for value in listed(table.get(name, [])):
        with faults.at(name):
            values.append(parse(value))
    return values


def _node(value: Any) -> str:
    return names.absolute(_pattern(value, "node"))


def _remap(table: Mapping[str, Any]) -> dict[str, str]:
    remap = {}
    faults = Faults()
    for old, new in table.items():
        with faults.at(old):
            remap[_name(old, "remap")] = _name(new, "remap")
    faults.check()
    return remap


def _rate(value: Any) -> float:
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if not number or not 0.0 < value < 1e9:
        raise ConfigError(f"max_rate is {shown(value)}, not a number of messages a second above 0")
    return float(value)


def _pattern(value: Any, name: str) -> str:
    if not isinstance(value, str) or not value:
        raise ConfigError(f"{name} is {shown(value)}, not a text")
    return value


def _address(value: Any) -> str:
    """Check a network, or a pattern for other addresses."""
    pattern = _pattern(value, "address")
    if re.match(r"[0-9A-Fa-f.:]+/", pattern):
        try:
            ip_network(pattern, strict=False)
        except ValueError as error:
            raise ConfigError(
                f"address is {shown(value)}, which is no network, such as 192.168.1.0/24"
            ) from error
    return pattern


def _name(value: Any, about: str) -> str:
    name = names.absolute(value) if isinstance(value, str) else ""
    if not names.is_valid(name):
        raise ConfigError(
            f"{about}: {shown(value)} is no ROS name: letters, digits and _ between slashes, no"
            " part beginning with a digit"
        )
    if len(name) > names.MAX_NAMESPACE:
        raise ConfigError(
            f"{about}: {shown(value)} has {len(name)} characters, and {names.MAX_NAMESPACE} are the"
            " most that leave room for a topic"
        )
    return name


def _namespace(value: Any) -> str:
    return "" if value == "/" else _name(value, "namespace")


def _qos(table: Mapping[str, Any]) -> dict[str, dict[str, int]]:
    qos = {}
    faults = Faults()
    for pattern, fields in table.items():
        about = f'qos."{pattern}"'
        with faults.at(pattern):
            name = names.absolute(_pattern(pattern, "qos"))
            qos[name] = _policies(table_of(fields, about), about)
    faults.check()
    return qos


def _policies(fields: Mapping[str, Any], about: str) -> dict[str, int]:
    policies = {}
    faults = Faults()
    with faults.at():
        only(fields, (*_POLICIES, *_NUMBERS), about)
    for key, value in fields.items():
        with faults.at(key):
            if key in _NUMBERS:
                policies[key] = whole(value, f"{about}.{key}", *_NUMBERS[key])
            elif key in _POLICIES:
                policies[key] = _policy(value, key, about)
    faults.check()
    return policies


def _policy(value: Any, key: str, about: str) -> int:
    known = _POLICIES[key]
    if isinstance(value, str) and value in known:
        return known[value]
    raise ConfigError(f"{about}.{key} is {shown(value)}, not {' or '.join(known)}")
