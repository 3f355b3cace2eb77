"""Who holds a device or a port on this machine, by Linux's /proc."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

PROC: Final = Path("/proc")
# Of a TCP socket that listens, in /proc/net/tcp.
_LISTENS: Final = "0A"
# Attack: a command line of megabytes.
_MAX_TEXT: Final = 65536
# What eProsima's agent calls itself.
_FOREIGN_AGENTS: Final = ("MicroXRCEAgent", "micro_ros_agent")


@dataclass(frozen=True)
class Process:
    """``name`` as people know it: the command without its folder, for Python the module."""

    pid: int
    name: str
    command: tuple[str, ...] = ()

    def __str__(self) -> str:
        return f"{self.name} (pid {self.pid})"

    @property
    def is_uros_agent(self) -> bool:
        """By its command line; one that was started by a program of its own has a socket only."""
        words = [os.path.basename(it) for it in self.command]
        python = bool(words) and words[0].startswith("python")
        for at, word in enumerate(words):
            if word == "uros" or (word == "__main__.py" and "uros" in self.command[at]):
                return "agent" in words[at + 1 : at + 2]
            # Ours is a script that Python runs, eProsima's is a program of that name.
            if python and word in _FOREIGN_AGENTS:
                return True
        return False

    @property
    def is_foreign_agent(self) -> bool:
        """Whether it is eProsima's agent."""
        return self.name in _FOREIGN_AGENTS and not self.is_uros_agent


def can_look() -> bool:
    """Whether this system has a /proc that tells all this."""
    return (PROC / "self" / "fd").is_dir()


def process(pid: int) -> Process:
    """What is known of a process; one that is gone has the name ``?``."""
    command = tuple(it for it in _read(PROC / str(pid) / "cmdline").split("\0") if it)
    name = _read(PROC / str(pid) / "comm").strip() or "?"
    if command:
        first = os.path.basename(command[0])
        # The kernel cuts names at 15 characters.
        if first.startswith(name):
            name = first
    return Process(pid, name, command)


def running(name: str) -> Process | None:
    """A process of this name (of at most 15 characters)."""
    for pid in _pids():
        if _read(PROC / str(pid) / "comm").strip() == name[:15]:
            return process(pid)
    return None


def environment(pid: int) -> dict[str, str] | None:
    """What a process was started with; None where we may not know."""
    try:
        with open(PROC / str(pid) / "environ", "rb") as file:
            raw = file.read(_MAX_TEXT * 16)
    except OSError:
        return None
    pairs = (it.decode("utf-8", "replace").partition("=") for it in raw.split(b"\0"))
    return {name: value for name, _, value in pairs if name}


def holders_of_file(path: str) -> list[Process]:
    """Other processes that have opened the file, as far as we may look."""
    wanted = os.path.realpath(path)
    return _holders(lambda target: target == wanted)


@dataclass(frozen=True)
class Taken:
    """A port in use: by whom is empty where we may not look."""

    protocol: str
    port: int
    holders: tuple[Process, ...]


def taken_port(protocol: str, port: int) -> Taken | None:
    """Who has the port, "udp" or "tcp" (where somebody listens); None: nobody."""
    inodes = set()
    for table in (protocol, protocol + "6"):
        for line in _read(PROC / "net" / table, 64 * 1024 * 1024).splitlines()[1:]:
            words = line.split()
            if len(words) < 10 or (protocol == "tcp" and words[3] != _LISTENS):
                continue
            number = words[1].rpartition(":")[2]
            try:
                if int(number, 16) == port:
                    inodes.add(f"socket:[{words[9]}]")
            except ValueError:
                continue
    if not inodes:
        return None
    return Taken(protocol, port, tuple(_holders(lambda target: target in inodes, own=True)))


def _holders(wanted: Callable[[str], bool], own: bool = False) -> list[Process]:
    found = []
    for pid in _pids():
        if pid == os.getpid() and not own:
            continue
        try:
            with os.scandir(PROC / str(pid) / "fd") as entries:
                held = any(wanted(_target(it.path)) for it in entries)
        except OSError:  # of another user, or gone
            continue
        if held:
            found.append(process(pid))
    return found


def _target(link: str) -> str:
    try:
        return os.readlink(link)
    except OSError:
        return ""


def _pids() -> Iterator[int]:
    try:
        words = os.listdir(PROC)
    except OSError:
        return
    for word in words:
        if word.isdecimal():
            yield int(word)


def _read(path: Path, limit: int = _MAX_TEXT) -> str:
    try:
        with open(path, "rb") as file:
            return file.read(limit).decode("utf-8", "replace")
    except OSError:
        return ""
