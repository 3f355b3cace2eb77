"""``uros agent``: the agent on one transport or several, with the C++ agent's options."""

from __future__ import annotations

import argparse
import os
import signal
import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final

from ..common import add_distro, domain, use_distro
from ..errors import ToolError
from . import status
from .options import admission as agent_admission
from .options import capture as agent_capture
from .options import limits, rules, state, status_socket
from .options.transports import (
    DEFAULT_DISCOVERY_PORT,
    TRANSPORTS,
    add_transport,
    make,
    make_discovery,
    port,
)

if TYPE_CHECKING:
    from ...agent.server import Server

# What the C++ agent calls its middlewares, and what stands for them here.
_MIDDLEWARES: Final = {
    "auto": "auto",
    "dds": "dds",
    "ros2": "ros2",
    "memory": "memory",
    "ced": "ced",
    "rtps": "dds",
}
# Groups of options: each module has DEFAULTS and add_options(), and makes what they ask for.
_PARTS: Final = (
    rules,
    agent_admission,
    limits,
    state,
    agent_capture,
    status_socket,
)
# Options that stand behind any of the transports, and what they are where they stand nowhere.
_COMMON: Final[dict[str, Any]] = {
    "middleware": "auto",
    "refs": [],
    "distro": None,
    "verbose": 4,
    "discovery": None,
    "p2p": None,
    "stop_at_eof": False,
    **{name: default for part in _PARTS for name, default in part.DEFAULTS.items()},
}
_EPILOG: Final = """\
'uros agent TRANSPORT --help' tells more. One agent may serve several transports:

  uros agent udp4 --port 8888
  uros agent serial --dev /dev/ttyACM0 --baudrate 921600
  uros agent udp4 --port 8888 tcp4 --port 8888 serial --dev /dev/ttyUSB0 -v 5

'uros agent status' shows how a running agent is.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the transports and their options."""
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = _EPILOG
    common = _common_options()
    transports = parser.add_subparsers(dest="transport", metavar="TRANSPORT", required=True)
    for name, help_text in TRANSPORTS.items():
        one = transports.add_parser(name, parents=[common], help=help_text, description=help_text)
        add_transport(name, one)
        # Not REMAINDER: behind another positional argument it would take the options too.
        more = one.add_argument(
            "more", nargs=argparse.PARSER, default=[], metavar="TRANSPORT",
            help="another transport with its options",
        )  # fmt: skip
        more.required = False
    status.add_parser(transports)
    parser.set_defaults(parse_more=parser.parse_args)


def _common_options() -> argparse.ArgumentParser:
    common = argparse.ArgumentParser(add_help=False, argument_default=argparse.SUPPRESS)
    common.add_argument(
        "-m", "--middleware", choices=tuple(_MIDDLEWARES), metavar="NAME",
        help="network to join: auto (default: dds, and ros2 for services where rclpy is"
        " installed), dds (rtps is its other name), ros2, memory, which stays inside the agent, or"
        " ced, the same with any text as a name",
    )  # fmt: skip
    add_distro(common, argparse.SUPPRESS)
    common.add_argument(
        "-r", "--refs", metavar="FILE", action="append",
        help="XML file of profiles that boards refer to by name; may be repeated",
    )  # fmt: skip
    common.add_argument(
        "-v", "--verbose", type=_verbosity, metavar="0-6",
        help="0 off, 1 critical, 2 error, 3 warning, 4 info (default), 5 debug, 6 trace",
    )  # fmt: skip
    common.add_argument(
        "-d", "--discovery", nargs="?", const=DEFAULT_DISCOVERY_PORT, type=port, metavar="PORT",
        help="tell boards that ask by multicast where this agent is"
        f" (default port {DEFAULT_DISCOVERY_PORT})",
    )  # fmt: skip
    common.add_argument("-P", "--p2p", type=int, metavar="PORT", help=argparse.SUPPRESS)
    common.add_argument("--stop-at-eof", action="store_true", help=argparse.SUPPRESS)
    for part in _PARTS:
        part.add_options(common)
    return common


def _verbosity(text: str) -> int:
    if text not in tuple("0123456"):
        raise argparse.ArgumentTypeError(f"{text!r} is no verbosity (0 to 6)")
    return int(text)


def run(args: argparse.Namespace) -> int:
    """Serve until a signal ends it; the exit status. Raises ToolError saying what is wrong."""
    from ...agent.objects.xml_profiles import ProfileError
    from ...agent.policy.rules import ControlError
    from ...agent.transports.base import TransportError

    if args.transport == status.NAME:
        return status.run(args)
    parts = _parts(args)
    try:
        options = _common(parts)
        use_distro(options.distro)
        return _serve(options, parts)
    except TransportError as error:
        raise ToolError(error.strerror or str(error)) from error
    except (ProfileError, ControlError) as error:
        raise ToolError(str(error)) from error


def _parts(args: argparse.Namespace) -> list[argparse.Namespace]:
    """The command line, a part for each transport."""
    parse: Callable[[list[str]], argparse.Namespace] = args.parse_more
    parts = [args]
    while parts[-1].more:
        parts.append(parse(parts[-1].more))
        if parts[-1].transport == status.NAME:
            raise ToolError("status is no transport: ask a running agent by 'uros agent status'")
    return parts


def _common(parts: list[argparse.Namespace]) -> argparse.Namespace:
    """The options that are the agent's: lists are joined, of single values the last one counts."""
    options = argparse.Namespace(**_COMMON)
    for part in parts:
        for name, default in _COMMON.items():
            if hasattr(part, name):
                value = getattr(part, name)
                joined = getattr(options, name) + value if isinstance(default, list) else value
                setattr(options, name, joined)
    return options


def _serve(options: argparse.Namespace, parts: list[argparse.Namespace]) -> int:
    from ...agent.agent import Agent
    from ...agent.log import INFO, WARNING, Log
    from ...agent.objects.xml_profiles import References
    from ...agent.server import Server
    from ...agent.watchdog import Watchdog
    from ...middleware import open_middleware

    references = References()
    for file in options.refs:
        references.load(file)
    control = rules.make_control(options)
    admission = agent_admission.make_admission(options, control)
    transports = [it for part in parts for it in make(part)]
    if options.discovery is not None:
        transports.append(make_discovery(options.discovery, transports))
    domain_of_agent = _domain_of_agent()
    middleware = open_middleware(_MIDDLEWARES[options.middleware])
    log = Log(options.verbose)
    agent = Agent(
        middleware, log, references, domain_of_agent, options.domain, control, admission,
        options.dead_time, limits.make_limits(options),
    )  # fmt: skip
    server = Server(agent, transports)
    _stop_on_signals(server)  # before anything is said: who reads it may want us to end
    watchdog = Watchdog(server, log)
    log(INFO, "Root", "set_verbose_level", "logger setup", f"verbose_level: {options.verbose}")
    if options.p2p is not None:
        log(WARNING, "Root", "main", "option ignored", "--p2p is not supported")
    if options.domain is not None:
        log(INFO, "Root", "main", "domain overridden", f"domain_id: {options.domain}")
    elif domain_of_agent:
        log(INFO, "Root", "main", "domain of the agent", f"domain_id: {domain_of_agent} (for 255)")
    capture = agent_capture.open_capture(options, agent)
    keeper = state.make_keeper(options, log)
    if keeper is not None:
        server.attachments.append(keeper)
    status_socket.attach(options, server)
    if options.stop_at_eof:
        threading.Thread(target=_stop_at_eof, args=(server,), daemon=True).start()
    watchdog.start()
    try:
        server.run()
        log(INFO, "Server", "stop", "server stopped")
    finally:
        watchdog.stop()
        if capture is not None:
            capture.close()
        log.close()
    return 0


def _domain_of_agent() -> int:
    """The domain for boards that leave it to the agent (they ask for 255)."""
    text = os.environ.get("XRCE_DOMAIN_ID_OVERRIDE") or "0"
    try:
        return domain(text)
    except (argparse.ArgumentTypeError, ValueError) as error:  # of 5000 digits
        raise ToolError(f"XRCE_DOMAIN_ID_OVERRIDE: {error}") from error


def _stop_at_eof(server: Server) -> None:
    """A parent that ends, however it ends, closes our standard input."""
    while os.read(0, 4096):  # not by sys.stdin, whose lock a daemon thread would keep at exit
        pass
    server.stop()


def _stop_on_signals(server: Server) -> None:
    """Also where the terminal is closed, or the connection to it lost, unless nohup has said that
    this is to be ignored. Nothing is read again: control files and certificates are looked at
    as they change, and a log on standard output is turned by what stands behind it.
    """
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: server.stop())
    hangup = getattr(signal, "SIGHUP", None)  # not on Windows
    if hangup is not None and signal.getsignal(hangup) != signal.SIG_IGN:
        signal.signal(hangup, lambda *_: server.stop())
