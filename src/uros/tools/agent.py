"""``uros agent``: the agent on a transport, with the C++ agent's options."""

from __future__ import annotations

import argparse
import os
import signal
import sys
import threading
from typing import TYPE_CHECKING

from .errors import ToolError

if TYPE_CHECKING:
    from ..agent.server import Server
    from ..transport.base import ServerTransport

# What the C++ agent calls its middlewares, and what stands for them here.
_MIDDLEWARES = {"dds": "dds", "memory": "memory", "ced": "memory", "rtps": "dds"}
_TRANSPORTS = {
    "udp4": "UDP over IPv4",
    "tcp4": "TCP over IPv4",
    "serial": "a serial device",
    "pseudoterminal": "a pseudo-terminal of its own",
}
DEFAULT_PORT = 8888


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the transports and their options."""
    common = argparse.ArgumentParser(add_help=False)
    common.add_argument(
        "-m", "--middleware", default="dds", choices=sorted(_MIDDLEWARES), metavar="NAME",
        help="network to join: dds (default; rtps is its other name), or memory, which stays"
        " inside the agent (ced)",
    )  # fmt: skip
    common.add_argument(
        "-r", "--refs", metavar="FILE", help="XML file of profiles that boards refer to by name"
    )
    common.add_argument(
        "-v", "--verbose", type=_verbosity, default=4, metavar="0-6",
        help="0 off, 1 critical, 2 error, 3 warning, 4 info (default), 5 debug, 6 trace",
    )  # fmt: skip
    common.add_argument(
        "--domain", type=_domain, metavar="N",
        help="put every board into this ROS domain (default: the one each board asks for)",
    )  # fmt: skip
    common.add_argument(
        "-d", "--discovery", nargs="?", const=7400, type=int, metavar="PORT", help=argparse.SUPPRESS
    )
    common.add_argument("--stop-at-eof", action="store_true", help=argparse.SUPPRESS)
    common.add_argument("-P", "--p2p", type=int, metavar="PORT", help=argparse.SUPPRESS)
    transports = parser.add_subparsers(dest="transport", metavar="TRANSPORT", required=True)
    for name, text in _TRANSPORTS.items():
        one = transports.add_parser(name, parents=[common], help=text, description=text)
        if name in ("udp4", "tcp4"):
            one.add_argument(
                "-p", "--port", type=_port, default=DEFAULT_PORT, metavar="N",
                help=f"port to listen on (default {DEFAULT_PORT}; 0: any that is free)",
            )  # fmt: skip
            continue
        if name == "serial":
            which = one.add_mutually_exclusive_group(required=True)
            which.add_argument("-D", "--dev", metavar="DEVICE", help="such as /dev/ttyACM0")
            which.add_argument("-f", "--file", metavar="FILE", help="file with the device's name")
        one.add_argument(
            "-b", "--baudrate", type=int, default=115200, metavar="N", help="default 115200"
        )


def _number(text: str, what: str, low: int, high: int) -> int:
    try:
        value = int(text)
    except ValueError:
        value = low - 1
    if not low <= value <= high:
        raise argparse.ArgumentTypeError(f"{text!r} is not {what} ({low} to {high})")
    return value


def _verbosity(text: str) -> int:
    return _number(text, "a verbosity", 0, 6)


def _domain(text: str) -> int:
    from ..middleware.base import MAX_DOMAIN

    return _number(text, "a ROS domain", 0, MAX_DOMAIN)


def _port(text: str) -> int:
    return _number(text, "a port", 0, 65535)


def run(args: argparse.Namespace) -> int:
    """Serve until Ctrl-C or SIGTERM; the exit status. Raises ToolError saying what is wrong."""
    from ..agent.profiles import ProfileError
    from ..transport.base import TransportError

    try:
        return _serve(args)
    except TransportError as error:
        raise ToolError(error.strerror or str(error)) from error
    except ProfileError as error:
        raise ToolError(str(error)) from error


def _serve(args: argparse.Namespace) -> int:
    from ..agent.agent import Agent
    from ..agent.log import INFO, WARNING, Log
    from ..agent.profiles import References
    from ..agent.server import Server
    from ..middleware import open_middleware

    references = References()
    if args.refs:
        references.load(args.refs)
    transport = _transport(args)
    domain = _domain_of_agent()
    middleware = open_middleware(_MIDDLEWARES[args.middleware])
    log = Log(args.verbose)
    server = Server(Agent(middleware, log, references, domain, args.domain), [transport])
    log(INFO, "Root", "set_verbose_level", "logger setup", f"verbose_level: {args.verbose}")
    for option in ("discovery", "p2p"):
        if getattr(args, option) is not None:
            log(WARNING, "Root", "main", "option ignored", f"--{option} is not supported yet")
    if args.domain is not None:
        log(INFO, "Root", "main", "domain overridden", f"domain_id: {args.domain}")
    elif domain:
        log(INFO, "Root", "main", "domain of the agent", f"domain_id: {domain} (for 255)")
    _stop_on_signals(server)
    if args.stop_at_eof:
        threading.Thread(target=_stop_at_eof, args=(server,), daemon=True).start()
    try:
        server.run()
        log(INFO, "Server", "stop", "server stopped")
    finally:
        log.close()
    return 0


def _domain_of_agent() -> int:
    """The domain for boards that leave it to the agent (they ask for 255)."""
    text = os.environ.get("XRCE_DOMAIN_ID_OVERRIDE") or "0"
    try:
        return _domain(text)
    except argparse.ArgumentTypeError as error:
        raise ToolError(f"XRCE_DOMAIN_ID_OVERRIDE: {error}") from error


def _transport(args: argparse.Namespace) -> ServerTransport:
    if args.transport == "udp4":
        from ..transport.udp import UdpServer

        return UdpServer(args.port)
    if args.transport == "tcp4":
        from ..transport.tcp import TcpServer

        return TcpServer(args.port)
    if sys.platform == "win32":
        raise ToolError("serial lines are not supported on Windows yet: use udp4 or tcp4")
    from ..transport.serial import PseudoTerminalServer, SerialServer

    if args.transport == "pseudoterminal":
        return PseudoTerminalServer(args.baudrate)
    return SerialServer(args.dev or args.file, args.baudrate, is_file=args.file is not None)


def _stop_at_eof(server: Server) -> None:
    """A parent that ends, however it ends, closes our standard input."""
    sys.stdin.buffer.read()
    server.stop()


def _stop_on_signals(server: Server) -> None:
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: server.stop())
