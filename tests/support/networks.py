"""Hosts in network namespaces of their own, joined by links; for processes of `run_isolated`.

A socket belongs to the namespace in which it was created, so one process can be several hosts:
what runs inside ``with host:`` runs on that host.
"""

import ctypes
import os
import select
import shlex
import subprocess
import sys
import time
from pathlib import Path

import pytest

_CLONE_NEWNET = 0x40000000
_TESTS = Path(__file__).resolve().parent.parent
SECONDS = 60.0


def run_isolated(module: str, scenario: str, *arguments: object, **options: object) -> str:
    """Call a function in a new process that has no network but the one it makes.

    Returns:
        What it printed.
    """
    given = ", ".join(
        [*map(repr, arguments), *(f"{name}={value!r}" for name, value in options.items())]
    )
    code = f"import {module} as scenarios; scenarios.{scenario}({given})"
    command = f"exec {shlex.quote(sys.executable)} -c {shlex.quote(code)}"
    done = subprocess.run(
        ["unshare", "--net", "--map-root-user", "sh", "-c", command],
        capture_output=True, text=True, timeout=150,
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(_TESTS), *sys.path])},
    )  # fmt: skip
    if "unshare failed" in done.stderr or "write failed" in done.stderr:
        pytest.skip("not on this platform: no network namespaces for us")
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


class Host:
    """A machine with a loopback interface; see the module."""

    def __init__(self) -> None:
        self._libc = ctypes.CDLL(None, use_errno=True)
        self._home = os.open("/proc/thread-self/ns/net", os.O_RDONLY)
        self._check(self._libc.unshare(_CLONE_NEWNET))
        self._own = os.open("/proc/thread-self/ns/net", os.O_RDONLY)
        for name in ("all", "default"):  # addresses are usable at once
            Path(f"/proc/sys/net/ipv6/conf/{name}/accept_dad").write_text("0")
        self.ip("link set lo up")
        self._check(self._libc.setns(self._home, _CLONE_NEWNET))

    def _check(self, result: int) -> None:
        if result:
            raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))

    def __enter__(self) -> "Host":
        self._check(self._libc.setns(self._own, _CLONE_NEWNET))
        return self

    def __exit__(self, *_: object) -> None:
        self._check(self._libc.setns(self._home, _CLONE_NEWNET))

    def ip(self, command: str) -> None:
        """Run the command `ip` in the namespace that is entered now."""
        subprocess.run(["ip", *command.split()], check=True)

    def plug(self, name: str, other: "Host", other_name: str) -> None:
        """Join two hosts by a link with interfaces of these names, which are up."""
        subprocess.run(
            ["ip", "link", "add", name, "netns", f"/proc/self/fd/{self._own}", "type", "veth",
             "peer", "name", other_name, "netns", f"/proc/self/fd/{other._own}"],
            check=True, pass_fds=(self._own, other._own),
        )  # fmt: skip
        for host, link in ((self, name), (other, other_name)):
            with host:
                host.ip(f"link set {link} up")


class Machines:
    """Middlewares, each on a host, and their data planes."""

    def __init__(self, *members):
        self.members = members  # (host, middleware)

    def until(self, done):
        end = time.monotonic() + SECONDS
        while not done():
            assert time.monotonic() < end, "it does not happen"
            self.turn()

    def turn(self):
        deadlines = [middleware.next_deadline() for _, middleware in self.members]
        at = min((at for at in deadlines if at is not None), default=time.monotonic() + 0.05)
        pause = min(0.05, max(0.0, at - time.monotonic()))
        select.select([middleware.fileno() for _, middleware in self.members], [], [], pause)
        for host, middleware in self.members:
            with host:
                middleware.dispatch()
                deadline = middleware.next_deadline()
                if deadline is not None and deadline <= time.monotonic():
                    middleware.tick()
