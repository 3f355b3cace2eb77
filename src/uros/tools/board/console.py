"""``uros board console``: show the console of a real board, as ``deploy`` does at its end."""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Final

from ...printable import printable, unguarded
from ..common import positive_float, positive_int
from ..errors import ToolError

if TYPE_CHECKING:
    from ...transport.serial_host import OpenPort

_EPILOG: Final = """\
Prints what the board prints, and sends what is typed. Frames for a micro-ROS agent on the same
line are counted and not printed. If the board is unplugged, the console waits for it.

Ctrl-C or Ctrl-] leaves. Ctrl-X interrupts the program (the board receives Ctrl-C), and Ctrl-D at
its prompt restarts it.

examples:

  uros board console --port /dev/ttyACM0
  uros board console --port /dev/ttyUSB0 --baudrate 921600
"""

_BAUD: Final = 115200
# After this silence, what looked like the beginning of a frame is printed as text.
_HOLD_SECONDS: Final = 0.2
_WAIT_MS: Final = 50
_BACK_SECONDS: Final = 0.2
_LEAVE: Final = b"\x03\x1d"
_INTERRUPT: Final = b"\x18"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros board console``."""
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = _EPILOG
    add_port(parser)
    add_seconds(parser)


def add_port(parser: argparse.ArgumentParser) -> None:
    """Declare ``--port`` and ``--baudrate``."""
    parser.add_argument(
        "--port", "-p", metavar="DEV",
        help="port of the board's console: /dev/ttyACM0, COM3, or a URL of pyserial (default: list"
        " the ports)",
    )  # fmt: skip
    parser.add_argument(
        "--baudrate", "-b", metavar="N", type=positive_int, default=_BAUD,
        help=f"baud rate, if the console is a UART (default: {_BAUD})",
    )  # fmt: skip


def add_seconds(parser: argparse.ArgumentParser) -> None:
    """Declare ``--seconds``."""
    parser.add_argument(
        "--seconds", metavar="S", type=positive_float,
        help="leave the console after so many seconds (default: until Ctrl-C)",
    )  # fmt: skip


def run(args: argparse.Namespace) -> int:
    """Show the console until Ctrl-C or the end of the time.

    Raises:
        ToolError: The port cannot be opened.
    """
    port = open_port(args, "uros board console")
    try:
        show(port, args.port, args.seconds)
    finally:
        port.close()
    return 0


# --- the port -------------------------------------------------------------------------


def open_port(args: argparse.Namespace, command: str) -> OpenPort:
    """Open the port of ``--port``.

    Args:
        args: The command line.
        command: The command to suggest if ``--port`` is missing.

    Raises:
        ToolError: There is no ``--port``, or it cannot be opened.
    """
    from ...agent.transports.base import TransportError
    from ...transport.serial_host import device_port

    if args.port is None:
        raise ToolError(_which(command))
    try:
        port = device_port(args.port, args.baudrate)
        port.open()
    except TransportError as error:
        raise ToolError(str(error)) from error
    except OSError as error:
        raise ToolError(_why(args.port, error)) from error
    return port


def _which(command: str) -> str:
    from ..doctor.serial import ports

    found = ports()
    if not found:
        return (
            "no --port is given, and there is no serial port: plug the board in with a cable that"
            " carries data"
        )
    known = ", ".join(f"{port} ({text})" if (text := _describe(port)) else port for port in found)
    return f"no --port is given; there are {known}: {command} ... --port {found[0]}"


def _describe(device: str) -> str:
    """Return manufacturer and product of a USB device, as far as this system knows them."""
    folder = os.path.realpath(
        os.path.join("/sys/class/tty", os.path.basename(os.path.realpath(device)), "device", "..")
    )
    words = []
    for name in ("manufacturer", "product"):
        try:
            with open(os.path.join(folder, name), encoding="utf-8", errors="replace") as file:
                words.append(" ".join(file.read(80).split()))
        except OSError:
            continue
    return " ".join(words)


def _why(device: str, error: OSError) -> str:
    """Return who uses the device, if known, else the system's error."""
    from ..doctor.finding import NOTE, PROBLEM
    from ..doctor.serial import check_device

    for finding in check_device(device, touch=False):
        if finding.fix and finding.state in (PROBLEM, NOTE):
            return f"{finding.what}; {finding.fix}"
    return f"{device}: {error.strerror or error}"


# --- the console ----------------------------------------------------------------------


def show(port: OpenPort, device: str, seconds: float | None) -> None:
    """Print what comes and send what is typed, until Ctrl-C, Ctrl-] or the end of the time.

    Args:
        port: The open port.
        device: Its name.
        seconds: How long; None for no limit.
    """
    from ...boards.deploy.console import ConsoleText

    text = ConsoleText()
    end = None if seconds is None else time.monotonic() + seconds
    try:
        with _keys() as keys:
            if keys is not None:
                _say(f"the console of {device}; Ctrl-C leaves, Ctrl-X interrupts the program")
            _carry(port, device, text, keys, end)
    except KeyboardInterrupt:
        pass
    _print(text.flush() + "\n", False)
    if text.frames:
        _say(
            f"{text.frames} XRCE frames were not printed; start an agent on this line:"
            f" uros agent serial --dev {device}"
        )


def _carry(port: OpenPort, device: str, text: Any, keys: int | None, end: float | None) -> None:
    from ...boards.deploy.console import Hints

    hints = Hints()
    heard = time.monotonic()
    while end is None or time.monotonic() < end:
        try:
            port.wait(_WAIT_MS)
            data = port.read(4096) or b""
            typed = _typed(keys)
            if any(key in typed for key in _LEAVE):
                return
            if typed:
                port.write(typed.replace(_INTERRUPT, b"\x03"))
        except OSError as error:
            _say(f"the line is lost ({error.strerror or error}); waiting for it")
            if not _reopen(port, keys, end):
                return
            _say(f"{device} is back")
            continue
        now = time.monotonic()
        shown = text.feed(data)
        if data:
            heard = now
        elif text.holding and now - heard > _HOLD_SECONDS:
            shown += text.flush()
        if shown:
            _print(shown, keys is not None)
            for hint in hints.feed(shown):
                _say(hint)


def _print(text: str, live: bool) -> None:
    """Print text. ``live`` is for a terminal with a user, who needs the editor's sequences."""
    if live:
        out = unguarded(sys.stdout)  # `ConsoleText` has cleaned it
        out.write(text)
        out.flush()
        return
    # Without a terminal, a piece may end between the two.
    print(printable(text.replace("\r", ""), "\n\t"), end="", flush=True)


def _reopen(port: OpenPort, keys: int | None, end: float | None) -> bool:
    while end is None or time.monotonic() < end:
        if any(key in _typed(keys) for key in _LEAVE):
            return False
        try:
            port.open()
            return True
        except OSError:
            time.sleep(_BACK_SECONDS)
    return False


def _say(text: str) -> None:
    print(f"uros: {text}", file=sys.stderr, flush=True)


@contextmanager
def _keys() -> Iterator[int | None]:
    """Make the terminal pass each key at once. None without a terminal, or on Windows."""
    try:
        import termios
        import tty

        fd = sys.stdin.fileno()
        if not os.isatty(fd) or os.tcgetpgrp(fd) != os.getpgrp():
            raise OSError("no terminal of ours")
        before = termios.tcgetattr(fd)
    except (ImportError, OSError, ValueError):
        yield None
        return
    try:
        tty.setcbreak(fd)
        now = termios.tcgetattr(fd)
        now[3] &= ~termios.ISIG
        now[3] &= ~termios.ICANON
        now[0] &= ~(termios.IXON | termios.ICRNL)
        termios.tcsetattr(fd, termios.TCSANOW, now)
        yield fd
    finally:
        termios.tcsetattr(fd, termios.TCSADRAIN, before)


def _typed(keys: int | None) -> bytes:
    if keys is None:
        return b""
    import select

    return os.read(keys, 256) if select.select([keys], [], [], 0)[0] else b""
