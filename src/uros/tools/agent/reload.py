"""SIGHUP: a running agent reads its rules, its admission and its certificates again."""

from __future__ import annotations

import argparse
import os
import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Final, NamedTuple

from ...agent.log import INFO, WARNING, Log
from ...agent.objects.kinds import key_label
from ...agent.policy.admission import Admission
from ...agent.policy.config_values import ConfigError
from ...agent.policy.replacement import replace_rules
from ...agent.policy.rules import Rules
from ..errors import ToolError
from .options import admission, rules

if TYPE_CHECKING:
    from ...agent.server import Server
    from .config.file import Config

# The options that are used without a restart, besides those of the rule for all boards.
_RELOADED: Final = {*rules.RULE, "control", "allow_key", "allow_net", "max_clients", "verbose"}
# The most clients that a line of the log names.
_MAX_NAMED: Final = 8


class Settings(NamedTuple):
    """The settings of an agent, as files and command line give them.

    Attributes:
        options: The options of file and command line.
        transports: The options of each transport: those on the command line, else of the file.
        replaced: How many transports of the file are not served, as the command line has others.
        rules: The rules of all files and of the command line.
        admission: The admission of all files and of the command line.
    """

    options: argparse.Namespace
    transports: list[argparse.Namespace]
    replaced: int
    rules: Rules
    admission: Admission


def make_settings(
    options: argparse.Namespace, config: Config | None, given: list[argparse.Namespace]
) -> Settings:
    """Read the files that the options name, and make the rules.

    Args:
        options: The options of file and command line.
        config: The configuration file; None without one.
        given: The options of each transport on the command line.

    Raises:
        ConfigError: A file or a rule is wrong.
        ToolError: An option is malformed.
    """
    client_rules = rules.make_rules(options, config)
    client_admission = admission.make_admission(options, client_rules)
    configured = config.transports if config is not None else []
    replaced = len(configured) if given else 0
    return Settings(options, given or configured, replaced, client_rules, client_admission)


def log_replaced(log: Log, settings: Settings) -> None:
    """Log that transports of the file are not served, if there are any."""
    if settings.replaced:
        log(
            INFO, "Root", "main", "transports of the file not served",
            f"{settings.options.config}: {settings.replaced}; the command line has its own",
        )  # fmt: skip


class Reloader:
    """Loads the settings again while the agent serves boards.

    A thread reads the files; the server's thread applies what is in them. A file that cannot be
    used is named in the log, and everything stays as it was.

    Args:
        server: The server of the agent.
        settings: The settings that the agent was started with.
        read: Reads the settings again; raises ConfigError or ToolError.
    """

    def __init__(self, server: Server, settings: Settings, read: Callable[[], Settings]) -> None:
        self._server = server
        self._started = settings
        self._read = read
        self._refused = ""  # why the last reload was refused
        server.troubles.append(self.trouble)
        self._running = False
        self._again = False  # another request came while one was served

    def request(self) -> None:
        """Reload soon. May be used from any thread and from a signal handler."""
        self._server.soon(self._begin)

    def trouble(self) -> str:
        """Return why the files cannot be used since the last reload; "" if they are in use."""
        if not self._refused:
            return ""
        return f"the last reload was refused, and a restart would fail: {self._refused}"

    def _begin(self) -> None:
        if self._running:
            self._again = True
            return
        self._running, self._again = True, False
        threading.Thread(target=self._load, name="uros-reload", daemon=True).start()

    def _load(self) -> None:
        try:
            settings = self._read()
        except (ConfigError, ToolError) as error:
            text = error.all_faults if isinstance(error, ConfigError) else str(error)
            self._server.soon(lambda: self._finish(lambda: self._refuse(text)))
        except Exception as error:
            fault = error
            self._server.soon(lambda: self._finish(lambda: self._fail(fault)))
        else:
            self._server.soon(lambda: self._finish(lambda: self._apply(settings)))

    def _finish(self, act: Callable[[], None]) -> None:
        self._running = False
        act()
        for transport in self._server.transports:
            transport.reload()
        if self._again:
            self._begin()

    def _refuse(self, text: str) -> None:
        self._refused = text
        self._server.note(
            WARNING, "Root", "reload", "not reloaded", f"{text} (the former rules stay in use)"
        )

    def _fail(self, error: Exception) -> None:
        self._refused = f"{type(error).__name__} (see the log)"
        self._server.agent.failed(error)

    def _apply(self, settings: Settings) -> None:
        server, agent = self._server, self._server.agent
        self._refused = ""
        replaced = replace_rules(agent, server.transports, settings.rules, settings.admission)
        agent.log.level = settings.options.verbose
        agent.message_hooks.follow_level()
        about = f"clients: {len(agent.clients)}"
        if replaced.removed:
            about += f", no longer admitted: {_named(replaced.removed)}"
        if replaced.waiting:
            about += f", new rules from their next session on: {_named(replaced.waiting)}"
        server.note(INFO, "Root", "reload", "rules reloaded", about)
        log_replaced(agent.log, settings)
        if changed := _restart_needed(self._started, settings):
            server.note(
                WARNING, "Root", "reload", "restart needed",
                f"changed, and used from the next start on: {', '.join(changed)}",
            )  # fmt: skip


def _restart_needed(started: Settings, read: Settings) -> list[str]:
    """Return what differs from what the agent was started with and needs a restart."""
    old, new = vars(started.options), vars(read.options)
    changed = [name for name in new if name not in _RELOADED and old[name] != new[name]]
    if started.transports != read.transports:
        changed.append("transports")
    return changed


def _named(keys: list[int]) -> str:
    more = f" and {len(keys) - _MAX_NAMED} more" if len(keys) > _MAX_NAMED else ""
    return " ".join(map(key_label, keys[:_MAX_NAMED])) + more


def has_terminal() -> bool:
    """Return whether the process has a controlling terminal, which has not been closed."""
    try:
        os.close(os.open("/dev/tty", os.O_RDONLY | os.O_NOCTTY))
    except OSError:
        return False
    return True
