"""The serial device: whether it is there, may be opened, is free, and what comes over it."""

from __future__ import annotations

import errno
import glob
import os
import stat
import time
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass
from typing import Final, Protocol

from . import process
from .finding import Finding, note, ok, problem, unknown, word

# Serial devices as Linux, macOS and the BSDs name them. A PC's ttyS0 to 31 are there without a
# port behind them, and so are no answer to "which is my board".
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
# What boards are set to, the likeliest first.
RATES: Final = (
    115200, 921600, 9600, 57600, 460800, 230400, 1000000, 2000000, 1500000, 500000, 38400, 19200,
)  # fmt: skip
# Bytes that a verdict other than "sound frames" takes, and how many are kept to judge.
_ENOUGH: Final = 12
_MOST: Final = 65536
# Of a text's octets so many in a hundred are printable; of noise about forty are.
_PRINTABLE: Final = 90
# Of a sound line's frames no more than one in so many is broken.
_BROKEN: Final = 20

_MOST_HOLDERS: Final = 3

SOUND, TEXT, NOISE, SILENCE = "sound", "text", "noise", "silence"

Say = Callable[[str], object]


# --- the device -------------------------------------------------------------------------------


def ports(patterns: Iterable[str] = _PORTS, by_id: str = _BY_ID) -> list[str]:
    """The serial ports that are there; by the names that stay, where there are such."""
    found = sorted(it for pattern in patterns for it in glob.glob(pattern))
    named = {os.path.realpath(it): it for it in glob.glob(os.path.join(by_id, "*"))}
    return [named.get(os.path.realpath(it), it) for it in found]


def check_device(
    device: str,
    agents: Collection[int] = (),
    known: Callable[[], list[str]] = ports,
    touch: bool = True,
) -> list[Finding]:
    """What hinders an agent from opening ``device``; ``agents`` are pids of agents of ours.

    The last finding is ``ok`` where somebody may listen on it now. Without ``touch`` it is not
    opened, which may reset a board.
    """
    from ...agent.transports.serial import has_termios, is_url

    if is_url(device):
        return [unknown("device", f"{device} is no device of this machine: nothing to look at")]
    if not has_termios():
        return [unknown("device", "serial devices are looked at on systems with termios only")]
    try:
        mode = os.stat(device).st_mode
    except ValueError:  # a NUL in the name
        return [problem("device", f"{device!r} is no name of a device", _choose(known()))]
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
    # Before it is said who holds it: half of all processes hold /dev/null, and nobody should end
    # his own shell.
    if touch and (stranger := _no_serial(device)):
        return [problem("device", f"{device} is {stranger}", _choose(known()))]
    holders = process.holders_of_file(device)
    if holders:
        return [*_modem_manager(device, holders), _busy(device, holders, agents)]
    if not touch:
        return [*_modem_manager(device, ()), ok("device", f"{device} is there and free")]
    return [*_modem_manager(device, ()), _try(device)]


def _choose(known: list[str]) -> str:
    if known:
        return f"use one that is there: --dev {' or --dev '.join(map(word, known))}"
    return "plug the board in with a cable that carries data: ls /dev/ttyACM* /dev/ttyUSB*"


def _missing(device: str, error: OSError, known: list[str]) -> Finding:
    if error.errno not in (errno.ENOENT, errno.ENOTDIR, errno.ELOOP):
        return problem("device", f"{device} cannot be looked at: {error.strerror}", _choose(known))
    what = f"{device} is not there"
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
    """What a character device is that can have no board behind it; empty: it may have one."""
    for standard in (0, 1, 2):
        try:
            if os.path.realpath(os.ttyname(standard)) == os.path.realpath(device):
                return "this terminal, not a board's line"
        except OSError:
            continue
    try:
        fd = os.open(device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    except OSError:
        return ""  # in use, for one; that is told further on
    try:
        return "" if os.isatty(fd) else "not a serial device"
    finally:
        os.close(fd)


def _forbidden(device: str) -> Finding:
    """The user may not open it: by the group that may, or for want of one."""
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
            f"{user} is in the group {group.gr_name}, which may use {device}, but was not yet when"
            " this session began",
            f"log out and in again, or for this terminal: newgrp {group.gr_name}",
        )
    return problem(
        "permission",
        f"{user} may not open {device}: its group is {group.gr_name}",
        f"sudo usermod -aG {group.gr_name} $USER, then log out and in again",
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
    if all(it.pid in agents or it.is_uros_agent for it in holders) and len(holders) == 1:
        return note("device", f"{device} is served by an agent of uros already: {names}",
                    f"for another program: kill {one.pid}")  # fmt: skip
    if one.name == "ModemManager":
        mend = "sudo systemctl disable --now ModemManager"
    else:
        # A list as long as that ends more than somebody means to.
        pids = " ".join(str(it.pid) for it in holders)
        mend = (
            f"kill {pids}"
            if len(holders) <= _MOST_HOLDERS
            else f"see whose: fuser -v {word(device)}"
        )
    return problem("busy", f"{device} is in use by {names}", mend)


def _modem_manager(device: str, holders: Collection[process.Process]) -> list[Finding]:
    if not os.path.basename(os.path.realpath(device)).startswith("ttyACM"):
        return []
    if any(it.name == "ModemManager" for it in holders):
        return []
    if process.running("ModemManager") is None:
        return []
    return [
        note(
            "modem manager",
            f"ModemManager runs, and talks to {device} for some seconds after it is plugged in",
            "sudo systemctl disable --now ModemManager, if no modem needs it",
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
        if text.startswith("errno: "):  # which says less than the words behind it
            text = text.partition(", ")[2]
        why, _, mend = text.partition(": ")
        return problem("device", f"{device} cannot be opened: {why}", mend or "use another device")
    return ok("device", f"{device} is there, free, and may be opened")


# --- what comes over it -------------------------------------------------------------------------


class Line(Protocol):
    """A line whose rate can be chosen. ``open`` and ``read`` may raise OSError."""

    def open(self, rate: int) -> None:
        """Begin to listen, or go on with another rate. What came before is dropped."""

    def read(self, timeout_ms: int) -> bytes:
        """What has come, waiting for it at most so long."""

    def close(self) -> None:
        """Twice is once."""


class DeviceLine:
    """A serial device by termios. It is opened once: each opening may reset a board."""

    def __init__(self, device: str) -> None:
        self._device = device
        self._fd = -1

    def open(self, rate: int) -> None:
        """See :class:`Line`; the OSError says what to do."""
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
        import select

        if not select.select([self._fd], [], [], timeout_ms / 1000)[0]:
            return b""
        try:
            data = os.read(self._fd, 4096)
        except BlockingIOError:
            return b""
        if not data:
            raise OSError(errno.EIO, "the line has ended")
        return data

    def close(self) -> None:
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1


@dataclass(frozen=True)
class Heard:
    """What came: ``kind`` is one of SOUND, TEXT, NOISE and SILENCE."""

    kind: str
    size: int = 0
    frames: int = 0
    broken: int = 0
    sample: str = ""


def judge(data: bytes) -> Heard:
    """What bytes of a line are: frames of a board, text, or neither."""
    from ...wire.framing import Deframer

    deframer = Deframer(0)
    frames = len(deframer.feed(data)) + deframer.foreign
    if frames:
        return Heard(SOUND, len(data), frames, deframer.crc_errors)
    if not data:
        return Heard(SILENCE)
    printable = sum(32 <= it < 127 or it in b"\r\n\t\x1b" for it in data)
    if len(data) >= _ENOUGH and printable * 100 >= len(data) * _PRINTABLE:
        last = data.decode("ascii", "replace").split("\n")
        whole = [it.strip() for it in last if it.strip()]
        return Heard(TEXT, len(data), 0, 0, max(whole, key=len, default="")[:60])
    return Heard(NOISE, len(data), 0, deframer.crc_errors)


def listen(line: Line, rate: int, seconds: float) -> Heard:
    """Listen until a sound frame has come, or so long; a little more to count broken ones.

    Raises OSError where the rate cannot be set, or the line is gone.
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
    """Whether a board's frames come at ``baud``; if not, at which of the usual rates they do."""
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
    # No ping from us: a board answers an agent's messages within its session only.
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
    """Something came that is no frame: try the other rates."""
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
            untried.append(rate)  # a rate that the device does not do
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
    left = f" (not tried, the device has not: {', '.join(map(str, untried))})" if untried else ""
    return problem(
        "baud",
        f"{first.size} bytes came over {device} at {baud} baud and no frame among them, nor at the"
        f" usual rates{left}",
        f"uros agent serial --dev {word(device)} --baudrate N, where N is the rate in the"
        " firmware's transport; or flash micro-ROS firmware",
    )
