"""What a configuration contradicts or lacks on this machine.

The parts that an agent would open are made as an agent makes them, so that both find the same
faults; nothing is opened, written or locked.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import socket
from collections.abc import Callable, Iterator
from typing import Any, Final

from ....agent.clock import Clock
from ....agent.policy.admission import MAX_CLIENTS
from ....agent.policy.config_values import ConfigError, key_of, listed
from ....agent.transports.base import TransportError
from ...errors import ToolError
from ..options.transports import make
from .file import Config

_FAMILIES: Final = {
    "udp4": (socket.AF_INET, socket.SOCK_DGRAM), "udp6": (socket.AF_INET6, socket.SOCK_DGRAM),
    "tcp4": (socket.AF_INET, socket.SOCK_STREAM), "tcp6": (socket.AF_INET6, socket.SOCK_STREAM),
}  # fmt: skip
# Options that do nothing without another one, by attribute.
_WITHOUT_EFFECT: Final = {
    "capture_size": "capture",
    "audit_size": "audit",
    "diagnostics_node": "diagnostics",
}


def find_faults(config: Config) -> None:
    """Record as problems what the configuration contradicts or lacks."""
    _check_transports(config)
    _check_ports(config)
    _check_devices(config)
    _check_options(config)
    _check_rules(config)
    _check_files(config)


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
            config.problem(error.strerror or str(error), *config.place_of(part))
            continue
        for transport in transports:
            for text in transport.doubts(Clock().time_ns() / 1e9):
                config.problem(text, *config.place_of(part), is_warning=True)


def _check_ports(config: Config) -> None:
    """Check that ports differ, and that they are free."""
    taken: dict[tuple[Any, int], str] = {}
    for name, place, family, host, port in _ports(config):
        if not port:
            continue
        before = taken.setdefault((family, port), name)
        if before != name:
            config.problem(f"{before} has port {port} already: choose another", *place)
        elif why := _why_not_free(family, host, port):
            config.problem(f"port {port} of {name}: {why}", *place, is_warning=True)


def _ports(config: Config) -> Iterator[tuple[str, tuple[str | int, ...], Any, str, int]]:
    """Yield name, place, family, host and port of what listens."""
    for part in config.transports:
        if part.transport in _FAMILIES:
            table, index = config.place_of(part)
            name = f"{part.transport} ([[transport]] number {index + 1})"
            yield name, (table, index, "port"), _FAMILIES[part.transport], "", part.port
    if address := config.options.get("metrics"):
        family = socket.AF_INET6 if ":" in address[0] else socket.AF_INET
        place = config.place_of_option("metrics")
        yield "metrics", place, (family, socket.SOCK_STREAM), *address
    if port := config.options.get("discovery"):
        # Several agents may share the port of discovery, but not with another transport.
        if any(part.transport == "udp4" and part.port == port for part in config.transports):
            config.problem(
                f"discovery: udp4 has port {port} already: choose another",
                *config.place_of_option("discovery"),
            )


def _why_not_free(family: tuple[int, int], host: str, port: int) -> str:
    """Return why a port cannot be opened now; "" if it can."""
    try:
        with socket.socket(*family) as sock:
            if family[1] == socket.SOCK_STREAM and os.name == "posix":
                sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            if family[0] == socket.AF_INET6:
                sock.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
            sock.bind((host, port))
    except PermissionError:
        return "this user may not open it: choose one from 1024 on, unless another user runs it"
    except OSError as error:
        return f"{error.strerror or error}: perhaps an agent with this file is running"
    return ""


def _check_devices(config: Config) -> None:
    """Check that each device is served once, and that it is there and free."""
    from ...doctor.process import holders_of_file

    taken: dict[str, int] = {}
    for part in config.transports:
        place = config.place_of(part)
        for device in _devices(part):
            name = os.path.realpath(device)
            before = taken.setdefault(name, place[1])
            if before != place[1]:
                config.problem(f"[[transport]] number {before + 1} has {device} already", *place)
            elif device.startswith("/") and not os.path.exists(device):
                config.problem(
                    f"{device} is not there now: an agent waits for it", *place, is_warning=True
                )
            elif device.startswith("/") and (holders := holders_of_file(device)):
                config.problem(
                    f"{device} is in use by {holders[0]}: perhaps an agent with this file is"
                    " running; a second one waits until it is free", *place, is_warning=True,
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
    ip = any(part.transport in _FAMILIES for part in config.transports)
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


def _check_files(config: Config) -> None:
    from ....agent.objects.xml_profiles import ProfileError, References

    options = config.options
    references = References()
    for file in options.get("refs", []):
        try:
            references.load(file)
        except ProfileError as error:
            config.problem(str(error), *config.place_of_option("refs"))
    taken: dict[str, str] = {}
    for name in ("state", "capture", "audit"):
        path = options.get(name)
        if path is None:
            continue
        place = config.place_of_option(name)
        before = taken.setdefault(os.path.realpath(path), name)
        if before != name:
            config.problem(f"{before} is {path} too: give each a file of its own", *place)
        folder = os.path.dirname(os.path.realpath(path))
        if not os.path.isdir(folder):
            config.problem(
                f"{path}: the folder {folder} does not exist: create it, unless systemd does"
                " (StateDirectory=)", *place, is_warning=True,
            )  # fmt: skip
        elif not os.access(folder, os.W_OK):
            config.problem(
                f"{path}: this user may not write into {folder}: the agent's user must",
                *place, is_warning=True,
            )  # fmt: skip
