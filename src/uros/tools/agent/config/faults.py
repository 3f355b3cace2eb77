"""What a configuration contradicts or lacks on this machine.

The parts that an agent would open are made as an agent makes them, so that both find the same
faults; ports are tried, and nothing is written or locked. What an agent that runs with the file has
open is no fault.
"""

from __future__ import annotations

import argparse
import errno
import importlib.util
import os
import re
import stat
from collections.abc import Callable, Iterator
from typing import Final, NamedTuple

from ....agent.clock import Clock
from ....agent.policy.admission import MAX_CLIENTS
from ....agent.policy.config_values import ConfigError, key_of, listed
from ....agent.transports.base import TransportError
from ....agent.transports.ip import family_of, listening_socket
from ....agent.transports.serial_device import is_path
from ....middleware import open_middleware
from ....middleware.base import MiddlewareError
from ...doctor.process import Process, can_look, holders_of_file, taken_port
from ...errors import ToolError
from ..options.transports import IP, anywhere, make
from ..port_in_use import name_holder
from .file import Config
from .running import OwnAgents

_METRICS: Final = "metrics"
# Middlewares that need a library or an installation which may be missing.
_NEEDING_LIBRARY: Final = ("dds", "ros2")
# Options that do nothing without another one, by attribute.
_WITHOUT_EFFECT: Final = {
    "capture_size": "capture",
    "audit_size": "audit",
    "diagnostics_node": "diagnostics",
}


def find_faults(config: Config) -> None:
    """Record as problems what the configuration contradicts or lacks."""
    own = OwnAgents(config.path)
    _check_transports(config)
    _check_ports(config, own)
    _check_devices(config, own)
    _check_options(config)
    _check_middleware(config)
    _check_rules(config)
    _check_refs(config)
    _check_written(config, own)


# --- transports ---------------------------------------------------------------------------------


def _check_transports(config: Config) -> None:
    if not config.transports and not config.problems:
        config.problem(
            "there is no [[transport]]: name one here, or on the command line", is_warning=True
        )
    for part in config.transports:
        try:
            transports = make(part)
        except TransportError as error:
            text = error.strerror or str(error)
            config.problem(text, *config.place_of(part), *_key_in(text))
            continue
        for transport in transports:
            for text in transport.doubts(Clock().time_ns() / 1e9):
                config.problem(text, *config.place_of(part), *_key_in(text), is_warning=True)
        _check_key(config, part)


def _key_in(text: str) -> tuple[str, ...]:
    """Return the key of the option that a fault of a transport begins with, if it does."""
    found = re.match(r"--([a-z-]+) ", text)
    return (found[1].replace("-", "_"),) if found else ()


def _check_key(config: Config, part: argparse.Namespace) -> None:
    """Check that not every user can read the private key of a transport."""
    path = getattr(part, "tls_key", None)
    if path is None or os.name != "posix":
        return
    try:
        mode = os.stat(path).st_mode
    except OSError:  # already a fault of the transport
        return
    if mode & (stat.S_IROTH | stat.S_IWOTH):
        config.problem(
            f"--tls-key {path}: every user of this machine may read or change it: chmod 600 {path},"
            " as the agent's user", *config.place_of(part), "tls_key", is_warning=True,
        )  # fmt: skip


class _Port(NamedTuple):
    """A port on which the agent would listen."""

    name: str
    place: tuple[str | int, ...]
    protocol: str
    host: str
    number: int


def _check_ports(config: Config, own: OwnAgents) -> None:
    """Check that ports differ, and that they can be opened."""
    taken: dict[tuple[str, int, int], str] = {}
    for port in _ports(config):
        if not port.number:
            continue
        key = (port.protocol, family_of(port.host), port.number)
        before = taken.setdefault(key, port.name)
        if before != port.name:
            config.problem(f"{before} has port {port.number} already: choose another", *port.place)
            continue
        try:
            listening_socket(port.protocol, port.host, port.number).close()
        except TransportError as error:
            _tell_port(config, own, port, error)


def _ports(config: Config) -> Iterator[_Port]:
    for part in config.transports:
        if part.transport in IP:
            table, index = config.place_of(part)
            name = f"{part.transport} ([[transport]] number {index + 1})"
            protocol = part.transport[:3].upper()
            yield _Port(name, (table, index, "port"), protocol, anywhere(part.transport), part.port)
    if address := config.options.get("metrics"):
        yield _Port(_METRICS, config.place_of_option("metrics"), "TCP", *address)
    if port := config.options.get("discovery"):
        # Several agents may share the port of discovery, but not with another transport.
        if any(part.transport == "udp4" and part.port == port for part in config.transports):
            config.problem(
                f"discovery: udp4 has port {port} already: choose another",
                *config.place_of_option("discovery"),
            )


def _tell_port(config: Config, own: OwnAgents, port: _Port, error: TransportError) -> None:
    """Record why a port cannot be opened now, in the words of the agent that would not start."""
    from ....agent.observability.prometheus import listen_trouble

    text = f"{port.name}: {error.strerror}"
    if port.name == _METRICS and isinstance(error.__cause__, OSError):
        text = listen_trouble(port.host, port.number, error.__cause__)
    if error.errno == errno.EACCES:
        text = (
            f"port {port.number} of {port.name}: this user may not open it: choose one from 1024"
            " on, unless another user runs it"
        )
    elif error.errno == errno.EADDRINUSE:
        taken = taken_port(port.protocol.lower(), port.number) if can_look() else None
        if own.has(taken.holders if taken else None):
            return
        text = name_holder(text)
    may_pass = error.errno in (errno.EACCES, errno.EADDRINUSE)
    config.problem(text, *port.place, is_warning=may_pass)


def _check_devices(config: Config, own: OwnAgents) -> None:
    """Check that each device is served once, and that it is there and free."""
    taken: dict[str, int] = {}
    for part in config.transports:
        place = config.place_of(part)
        for device in _devices(part):
            is_file = part.transport != "canfd" and is_path(device)
            before = taken.setdefault(os.path.realpath(device) if is_file else device, place[1])
            if before != place[1]:
                config.problem(f"[[transport]] number {before + 1} has {device} already", *place)
            elif is_file and not os.path.exists(device):
                config.problem(
                    f"{device} is not there now: an agent waits for it", *place, is_warning=True
                )
            elif is_file and (holders := holders_of_file(device)) and not own.has(holders):
                config.problem(
                    f"{device} is in use by {holders[0]}: an agent waits until it is free",
                    *place, is_warning=True,
                )  # fmt: skip


def _devices(part: argparse.Namespace) -> list[str]:
    if part.transport == "multiserial":
        return " ".join(part.devs or []).split()
    if part.transport in ("serial", "canfd") and part.dev:
        return [part.dev]
    return []


# --- the agent -----------------------------------------------------------------------------------


def _check_options(config: Config) -> None:
    options = config.options
    for name, other in _WITHOUT_EFFECT.items():
        if name in options and other not in options:
            table, key = config.place_of_option(name)
            config.problem(
                f"{key} has no effect without {config.place_of_option(other)[1]}", table, key,
                is_warning=True,
            )  # fmt: skip
    ip = any(part.transport in IP for part in config.transports)
    if options.get("discovery") and config.transports and not ip:
        config.problem(
            "discovery has no effect without a udp or tcp transport",
            *config.place_of_option("discovery"), is_warning=True,
        )  # fmt: skip
    if options.get("max_clients", 1) > MAX_CLIENTS:
        config.problem(
            f"max_clients is {options['max_clients']}, not a whole number from 1 to {MAX_CLIENTS}",
            *config.place_of_option("max_clients"),
        )  # fmt: skip
    message, memory = options.get("max_message"), options.get("max_memory")
    if message and memory and message > memory * 1024 * 1024:
        config.problem(
            f"max_message is over max_memory, which has {memory} MB",
            *config.place_of_option("max_message"),
        )  # fmt: skip
    if "metrics" in options and importlib.util.find_spec("prometheus_client") is None:
        config.problem(
            "metrics need prometheus_client, which is not installed: python -m pip install"
            " prometheus_client", *config.place_of_option("metrics"),
        )  # fmt: skip


def _check_middleware(config: Config) -> None:
    name = config.options.get("middleware")
    if name in _NEEDING_LIBRARY:
        try:
            open_middleware(name).close()
        except MiddlewareError as error:
            config.problem(str(error), *config.place_of_option("middleware"))


def _check_rules(config: Config) -> None:
    from ....agent.policy.admission import make_admission
    from ....agent.policy.rules import Rules
    from ..options.rules import RULE, rule_of

    for name in RULE:
        try:
            if rule := rule_of({name: config.options.get(name)}):
                Rules().add(rule)
        except ConfigError as error:
            config.error(error, "[rules]", "rules")
        except ToolError as error:
            config.problem(f"[rules]: {error}", "rules", name)
    rules = Rules()
    for file in config.options.get("control", []):
        _try_file(config, lambda file=file: rules.load(file))  # type: ignore[misc]
    own = (config.options.get("allow_key", []), config.options.get("allow_net", []))
    before = len(config.problems)
    _try_file(config, lambda: make_admission(rules.admission))
    try:
        make_admission((), *own)
    except ConfigError as error:
        config.error(error, "[admission]", "admission")
    if len(config.problems) > before:
        return
    admission = make_admission(rules.admission, *own)
    for rule in config.clients:
        for key in map(key_of, listed(rule.get("key", []))):
            if not admission.admits_key(key):
                config.problem(
                    f"a rule for key 0x{key:08X}, which [admission] does not admit",
                    *config.place_of_client(rule), is_warning=True,
                )  # fmt: skip


def _try_file(config: Config, call: Callable[[], object]) -> None:
    """Record the faults of files of rules that a call finds."""
    try:
        call()
    except ConfigError as error:
        for fault in error.faults:
            config.problem(str(fault), *config.place_of_option("control"))


def _check_refs(config: Config) -> None:
    from ....agent.objects.xml_profiles import ProfileError, References

    references = References()
    for file in config.options.get("refs", []):
        try:
            references.load(file)
        except ProfileError as error:
            config.problem(str(error), *config.place_of_option("refs"))


def _check_written(config: Config, own: OwnAgents) -> None:
    """Check the files that an agent writes: it refuses to spoil other files."""
    taken: dict[str, str] = {}
    for name in ("state", "capture", "audit"):
        path = config.options.get(name)
        if path is None:
            continue
        place = config.place_of_option(name)
        if "\0" in path:
            config.problem(f"{path!r}: a name of a file has no zero byte", *place)
            continue
        before = taken.setdefault(os.path.realpath(path), name)
        folder = os.path.dirname(os.path.realpath(path))
        if before != name:
            config.problem(f"{before} is {path} too: give each a file of its own", *place)
        elif not os.path.isdir(folder):
            config.problem(
                f"{path}: there is no folder {folder}: create it, or start the unit of systemd that"
                " creates it (StateDirectory=)", *place,
            )  # fmt: skip
        elif os.path.exists(path) and not os.access(path, os.R_OK | os.W_OK):
            config.problem(
                f"{path}: this user may not read and write it: the agent's user must",
                *place, is_warning=True,
            )  # fmt: skip
        elif why := _why_refused(name, path):
            config.problem(why, *place)
        elif (holders := _agents_with(path)) and not own.has(holders):
            config.problem(
                f"{path} is in use by another agent (pid {holders[0].pid}): give each agent a file"
                " of its own", *place, is_warning=True,
            )  # fmt: skip
        elif not os.access(folder, os.W_OK):
            config.problem(
                f"{path}: this user may not write into {folder}: the agent's user must",
                *place, is_warning=True,
            )  # fmt: skip


def _why_refused(name: str, path: str) -> str:
    """Return why an agent would refuse what a file is now; "" if it would not."""
    from ....agent.observability.audit import AuditError, check_audit_file
    from ....agent.observability.capture import CaptureError, check_capture_file
    from ....agent.persistence.journal import JournalError, check_state_file

    if os.path.isdir(path):
        return f"--{name} {path}: it is a directory: name a file in it"
    check = {"state": check_state_file, "audit": check_audit_file, "capture": check_capture_file}
    try:
        check[name](path)
    except (AuditError, CaptureError, JournalError) as error:
        return str(error)
    except OSError as error:
        return f"--{name} {path}: {error.strerror}"
    return ""


def _agents_with(path: str) -> list[Process]:
    """Return the agents that have a file open; other programs may read it."""
    if not os.path.exists(path):
        return []
    return [holder for holder in holders_of_file(path) if holder.is_uros_agent]
