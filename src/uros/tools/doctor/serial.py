"""Checks a serial device: existence, permission, other users, and the data that arrives."""

from __future__ import annotations

import errno
import glob
import os
import stat
import time
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass
from typing import Final, Protocol

from ...agent.transports.line_faults import RATES, is_text
from . import process
from .finding import Finding, note, ok, problem, unknown, word

# Names of serial devices on Linux, macOS and the BSDs. A PC's ttyS0 to ttyS31 exist without a port
# behind them, so they do not tell which device is the board.
_PORTS: Final = (
    "/dev/ttyACM*",
    "/dev/ttyUSB*",
    "/dev/ttyAMA*",
    "/dev/ttyTHS*",
    "/dev/rfcomm*",
    "/dev/cu.usb*",
    "/dev/cuaU*",
)
_BY_ID: Final = "/dev/serial/by-id"
# The most bytes that are kept.
_MOST: Final = 65536
# On a sound line at most one in so many frames is broken.
_BROKEN: Final = 20

_MOST_HOLDERS: Final = 3

SOUND, TEXT, NOISE, SILENCE = "sound", "text", "noise", "silence"

Say = Callable[[str], object]


# --- the device -------------------------------------------------------------------------------


def ports(patterns: Iterable[str] = _PORTS, by_id: str = _BY_ID) -> list[str]:
    """Return the serial ports of this machine, by their stable names if they have one."""
    found = sorted(path for pattern in patterns for path in glob.glob(pattern))
    named = {os.path.realpath(path): path for path in glob.glob(os.path.join(by_id, "*"))}
    return [named.get(os.path.realpath(path), path) for path in found]


def check_device(
    device: str,
    agents: Collection[int] = (),
    known: Callable[[], list[str]] = ports,
    touch: bool = True,
) -> list[Finding]:
    """Check whether an agent could open a serial device.

    Args:
        device: The device.
        agents: Process ids of uros agents.
        known: Lists the serial ports of this machine.
        touch: Whether to open the device, which may reset a board.

    Returns:
        The findings. The last one is ``ok`` if the device can be used now.
    """
    from ...agent.transports.serial import has_termios, is_url

    if is_url(device):
        return [unknown("device", f"{device} is not a device of this machine: nothing to check")]
    if not has_termios():
        return [unknown("device", "serial devices are checked on systems with termios only")]
    try:
        mode = os.stat(device).st_mode
    except ValueError:  # a NUL in the name
        return [problem("device", f"{device!r} is not the name of a device", _choose(known()))]
    except OSError as error:
        return [_missing(device, error, known())]
    if not stat.S_ISCHR(mode):
        return [
            problem(
                "device",
                f"{device} is {_kind(mode)}, not a serial device",
                _choose(known()),
            )
        ]
    if not os.access(device, os.R_OK | os.W_OK):
        return [_forbidden(device)]
    # Before the holders are named: half of all processes hold /dev/null, and nobody should end
    # their own shell.
    if touch and (kind := _no_serial(device)):
        return [problem("device", f"{device} is {kind}", _choose(known()))]
    holders = process.holders_of_file(device)
    if holders:
        return [*_modem_manager(device, holders), _busy(device, holders, agents)]
    if not touch:
        return [
            *_modem_manager(device, ()),
            ok("device", f"{device} exists and is free", about=device),
        ]
    return [*_modem_manager(device, ()), _try(device)]


def _choose(known: list[str]) -> str:
    if known:
        return f"use one that exists: --dev {' or --dev '.join(map(word, known))}"
    return "plug the board in with a cable that carries data: ls /dev/ttyACM* /dev/ttyUSB*"


def _missing(device: str, error: OSError, known: list[str]) -> Finding:
    if error.errno not in (errno.ENOENT, errno.ENOTDIR, errno.ELOOP):
        return problem("device", f"{device} cannot be examined: {error.strerror}", _choose(known))
    what = f"{device} does not exist"
    if os.path.islink(device):
        what += f": it points to {os.readlink(device)}, which is gone: the board is unplugged"
    elif known:
        what += f"; there are {', '.join(known)}"
    else:
        what += ", nor any other serial port: the board seems to be unplugged"
    if not known and process.running("brltty"):
        return problem(
            "device",
            what + ", or brltty has taken it for a braille display",
            "sudo apt remove brltty, then plug the board in again",
        )
    return problem("device", what, _choose(known))


def _kind(mode: int) -> str:
    for test, name in (
        (stat.S_ISREG, "a file"),
        (stat.S_ISDIR, "a folder"),
        (stat.S_ISBLK, "a disk"),
        (stat.S_ISFIFO, "a pipe"),
        (stat.S_ISSOCK, "a socket"),
    ):
        if test(mode):
            return name
    return "something else"


def _no_serial(device: str) -> str:
    """Say what a character device is if no board can be behind it, else return nothing."""
    for standard in (0, 1, 2):
        try:
            if os.path.realpath(os.ttyname(standard)) == os.path.realpath(device):
                return "this terminal, not a board's line"
        except OSError:
            continue
    try:
        fd = os.open(device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    except OSError:
        return ""  # in use, for example, which is reported later
    try:
        return "" if os.isatty(fd) else "not a serial device"
    finally:
        os.close(fd)


def _forbidden(device: str) -> Finding:
    """Say which group may open the device, or that there is none."""
    import grp
    import pwd

    about = os.stat(device)
    user = _user()
    try:
        group = grp.getgrgid(about.st_gid)
    except KeyError:
        group = None
    shared = about.st_mode & 0o060 == 0o060 and about.st_gid != 0
    if group is None or not shared:
        return problem(
            "permission",
            f"{user} may not read and write {device}, nor does it belong to a group that may",
            f"sudo chmod a+rw {word(device)}",
        )
    try:
        member = user in group.gr_mem or pwd.getpwnam(user).pw_gid == about.st_gid
    except KeyError:
        member = False
    if member:
        return problem(
            "permission",
            f"{user} joined the group {group.gr_name}, which may use {device}, after this session"
            " began",
            f"log out and in again, or for this terminal: newgrp {group.gr_name}",
            about=device,
            kind=f"joined {group.gr_name}",
        )
    return problem(
        "permission",
        f"{user} may not open {device}: its group is {group.gr_name}",
        f"sudo usermod -aG {group.gr_name} $USER, then log out and in again",
        about=device,
        kind=group.gr_name,
    )


def _user() -> str:
    import pwd

    try:
        return pwd.getpwuid(os.getuid()).pw_name
    except KeyError:
        return f"user {os.getuid()}"


def _busy(device: str, holders: list[process.Process], agents: Collection[int]) -> Finding:
    one = holders[0]
    names = " and ".join(map(str, holders[:_MOST_HOLDERS]))
    if len(holders) == 1 and (one.pid in agents or one.is_uros_agent):
        return note("device", f"{device} is served by a uros agent already: {names}",
                    f"to use it in another program: kill {one.pid}", about=device, kind=str(one),
                    )  # fmt: skip
    if one.name == "ModemManager":
        fix = "sudo systemctl disable --now ModemManager"
    else:
        # With so many, kill would end more than the user means to.
        pids = " ".join(str(holder.pid) for holder in holders)
        fix = (
            f"kill {pids}"
            if len(holders) <= _MOST_HOLDERS
            else f"list them: fuser -v {word(device)}"
        )
    return problem("busy", f"{device} is in use by {names}", fix)


def _modem_manager(device: str, holders: Collection[process.Process]) -> list[Finding]:
    if not os.path.basename(os.path.realpath(device)).startswith("ttyACM"):
        return []
    if any(holder.name == "ModemManager" for holder in holders):
        return []
    if process.running("ModemManager") is None:
        return []
    return [
        note(
            "modem manager",
            f"ModemManager runs, and sends to {device} for some seconds after it is plugged in",
            "sudo systemctl disable --now ModemManager, if no modem needs it",
            about=device,
        )
    ]


def _try(device: str) -> Finding:
    """Open it once, as the agent does."""
    import termios

    from ...agent.transports.terminal import open_device, reason

    try:
        os.close(open_device(device, 115200))
    except (OSError, termios.error) as error:
        text = reason(device, error)
        if text.startswith("errno: "):  # the text after it says more
            text = text.partition(", ")[2]
        why, _, fix = text.partition(": ")
        return problem("device", f"{device} cannot be opened: {why}", fix or "use another device")
    return ok("device", f"{device} exists, is free, and can be opened")


# --- what comes over it -------------------------------------------------------------------------


class Line(Protocol):
    """A serial line with a selectable rate. ``open`` and ``read`` may raise OSError."""

    def open(self, rate: int) -> None:
        """Start to listen, or change the rate. Earlier input is dropped."""

    def read(self, timeout_ms: int) -> bytes:
        """Return the bytes that have come, and wait for them at most so long."""

    def close(self) -> None:
        """Close the line. Idempotent."""


class DeviceLine:
    """A serial device. It is opened only once, because opening may reset a board."""

    def __init__(self, device: str) -> None:
        self._device = device
        self._fd = -1

    def open(self, rate: int) -> None:
        """See :class:`Line`. The OSError's text has the remedy."""
        import termios

        from ...agent.transports.baud import check_baud_rate, set_baud_rate
        from ...agent.transports.terminal import open_device, reason

        try:
            if self._fd < 0:
                self._fd = open_device(self._device, check_baud_rate(rate))
            else:
                set_baud_rate(self._fd, check_baud_rate(rate))
                termios.tcflush(self._fd, termios.TCIFLUSH)
        except (OSError, termios.error) as error:
            raise OSError(error.args[0], reason(self._device, error)) from error

    def read(self, timeout_ms: int) -> bytes:
        """See :class:`Line`."""
        import select

        if not select.select([self._fd], [], [], timeout_ms / 1000)[0]:
            return b""
        try:
            data = os.read(self._fd, 4096)
        except BlockingIOError:
            return b""
        if not data:
            raise OSError(errno.EIO, "the line was closed")
        return data

    def close(self) -> None:
        """See :class:`Line`."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1


@dataclass(frozen=True)
class Heard:
    """What came over a line. ``kind`` is SOUND, TEXT, NOISE or SILENCE."""

    kind: str
    size: int = 0
    frames: int = 0
    broken: int = 0
    sample: str = ""


def judge(data: bytes) -> Heard:
    """Tell whether bytes of a line are a board's frames, text, or neither."""
    from ...wire.framing import Deframer

    deframer = Deframer(0)
    frames = len(deframer.feed(data)) + deframer.foreign
    if frames:
        return Heard(SOUND, len(data), frames, deframer.crc_errors)
    if not data:
        return Heard(SILENCE)
    if is_text(data):
        last = data.decode("ascii", "replace").split("\n")
        whole = [line.strip() for line in last if line.strip()]
        return Heard(TEXT, len(data), 0, 0, max(whole, key=len, default="")[:60])
    return Heard(NOISE, len(data), 0, deframer.crc_errors)


def listen(line: Line, rate: int, seconds: float) -> Heard:
    """Listen for a sound frame, and a little longer to count broken ones.

    Args:
        line: The line.
        rate: Its baud rate.
        seconds: How long to listen if no sound frame comes.

    Raises:
        OSError: The rate cannot be set, or the line is lost.
    """
    line.open(rate)
    heard = bytearray()
    end = time.monotonic() + seconds
    settled = False
    while (left := end - time.monotonic()) > 0 and len(heard) < _MOST:
        data = line.read(max(1, int(left * 1000)))
        heard += data
        if data and not settled and b"\x7e" in heard and judge(bytes(heard)).kind == SOUND:
            settled = True
            end = min(end, time.monotonic() + seconds / 4)
    return judge(bytes(heard))


def check_line(
    device: str,
    line: Line,
    baud: int,
    seconds: float,
    say: Say = lambda text: None,
    rates: Iterable[int] = RATES,
) -> Finding:
    """Check whether frames come at ``baud``, or else at which of the usual rates.

    Args:
        device: Name of the device.
        line: The device.
        baud: The rate that the board should have.
        seconds: How long to listen at each rate.
        say: Prints what is being done.
        rates: Other rates to try.
    """
    try:
        say(f"listening on {device} at {baud} baud for {seconds:g} s")
        heard = listen(line, baud, seconds)
        if heard.kind == SOUND:
            return _sound(device, baud, heard)
        if heard.kind == SILENCE:
            return _silence(device, baud, seconds)
        return _elsewhere(device, line, baud, seconds, heard, say, rates)
    except OSError as error:
        return unknown("baud", f"{device} cannot be listened to: {error.strerror or error}")
    finally:
        line.close()


def _sound(device: str, baud: int, heard: Heard) -> Finding:
    if heard.broken * _BROKEN > heard.frames:
        return problem(
            "baud",
            f"{heard.broken} of {heard.frames + heard.broken} frames on {device} are broken at"
            f" {baud} baud",
            "use a shorter cable with a common ground, or a lower rate in the firmware and with"
            " --baudrate",
        )
    return ok("baud", f"sound XRCE frames come over {device} at {baud} baud ({heard.frames})")


def _silence(device: str, baud: int, seconds: float) -> Finding:
    # No ping is sent: a board answers an agent only within its session.
    return problem(
        "baud",
        f"nothing came over {device} within {seconds:g} s: the board has not started, has no"
        " micro-ROS firmware on this port, or its TX and our RX are not connected",
        "press the board's reset button while this runs: uros doctor --dev"
        f" {word(device)} --baudrate {baud} --seconds {max(10, round(seconds * 3))}",
    )


def _elsewhere(
    device: str, line: Line, baud: int, seconds: float, first: Heard, say: Say,
    rates: Iterable[int],
) -> Finding:  # fmt: skip
    """Try the other rates: something came, but no frame."""
    text_at: tuple[int, Heard] | None = (baud, first) if first.kind == TEXT else None
    untried = []
    for rate in rates:
        if rate == baud:
            continue
        say(f"no frames; trying {rate} baud")
        try:
            heard = listen(line, rate, seconds)
        except OSError as error:
            if error.errno in (errno.EIO, errno.ENODEV, errno.ENXIO, errno.EBADF):
                raise
            untried.append(rate)  # the device does not support it
            continue
        if heard.kind == SOUND:
            return problem(
                "baud",
                f"the board on {device} sends at {rate} baud, not at {baud}",
                f"uros agent serial --dev {word(device)} --baudrate {rate}",
            )
        if heard.kind == TEXT and text_at is None:
            text_at = rate, heard
    if text_at is not None:
        rate, heard = text_at
        return problem(
            "baud",
            f"only text comes over {device} at {rate} baud ({heard.sample!r}): this is the board's"
            " console, or its firmware is without micro-ROS",
            "flash firmware with a micro-ROS transport on this port, or use the board's other port",
        )
    left = f" (not supported by the device: {', '.join(map(str, untried))})" if untried else ""
    return problem(
        "baud",
        f"{first.size} bytes came over {device} at {baud} baud, but no frame, nor at the usual"
        f" rates{left}",
        f"uros agent serial --dev {word(device)} --baudrate N, where N is the rate in the"
        " firmware's transport; or flash micro-ROS firmware",
    )
