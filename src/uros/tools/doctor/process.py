"""Finds the processes that use a device or a port, by Linux's /proc."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

PROC: Final = Path("/proc")
# State of a listening TCP socket in /proc/net/tcp.
_LISTENS: Final = "0A"
# Attack: a command line of megabytes.
_MAX_TEXT: Final = 65536
# Process names of eProsima's agent.
_FOREIGN_AGENTS: Final = ("MicroXRCEAgent", "micro_ros_agent")


@dataclass(frozen=True)
class Process:
    """A process. ``name`` is the command without its folder."""

    pid: int
    name: str
    command: tuple[str, ...] = ()

    def __str__(self) -> str:
        return f"{self.name} (pid {self.pid})"

    @property
    def is_uros_agent(self) -> bool:
        """Whether the command line is that of ``uros agent``."""
        words = [os.path.basename(word) for word in self.command]
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
    """Return whether this system has /proc."""
    return (PROC / "self" / "fd").is_dir()


def process(pid: int) -> Process:
    """Return what is known of a process. One that has ended has the name ``?``."""
    command = tuple(word for word in _read(PROC / str(pid) / "cmdline").split("\0") if word)
    name = _read(PROC / str(pid) / "comm").strip() or "?"
    if command:
        first = os.path.basename(command[0])
        # The kernel cuts names at 15 characters.
        if first.startswith(name):
            name = first
    return Process(pid, name, command)


def running(name: str) -> Process | None:
    """Return a process of this name, of which the first 15 characters count."""
    for pid in _pids():
        if _read(PROC / str(pid) / "comm").strip() == name[:15]:
            return process(pid)
    return None


def uros_agents() -> list[Process]:
    """Return the processes of all users that are uros agents by their command lines."""
    return [each for each in map(process, _pids()) if each.is_uros_agent]


def folder(pid: int) -> str:
    """Return the working folder of a process; "" without permission."""
    return _target(str(PROC / str(pid) / "cwd"))


def environment(pid: int) -> dict[str, str] | None:
    """Return the environment that a process was started with, or None without permission."""
    try:
        with open(PROC / str(pid) / "environ", "rb") as file:
            raw = file.read(_MAX_TEXT * 16)
    except OSError:
        return None
    pairs = (pair.decode("utf-8", "replace").partition("=") for pair in raw.split(b"\0"))
    return {name: value for name, _, value in pairs if name}


def holders_of_file(path: str) -> list[Process]:
    """Return the other processes that have opened the file, as far as permissions allow."""
    wanted = os.path.realpath(path)
    return _holders(lambda target: target == wanted)


@dataclass(frozen=True)
class Taken:
    """A port in use. ``holders`` is empty without permission to see them."""

    protocol: str
    port: int
    holders: tuple[Process, ...]


def taken_port(protocol: str, port: int) -> Taken | None:
    """Return who uses a port of ``udp``, or listens on one of ``tcp``; None if nobody does."""
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
                held = any(wanted(_target(entry.path)) for entry in entries)
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
