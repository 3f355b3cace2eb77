"""``uros agent``: serve boards on one transport or several, with the C++ agent's options."""

from __future__ import annotations

import argparse
import gc
import os
import signal
import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final

from ..common import DISTRO_HELP, distro_name, domain, use_distro
from ..errors import ToolError
from . import status
from .options import admission, capture, limits, rules, state, status_socket
from .options.group import OptionGroup
from .options.transports import DEFAULT_DISCOVERY_PORT, TRANSPORTS, make, make_discovery, port

if TYPE_CHECKING:
    from ...agent.server import Server

# The names of middlewares on the command line, which include the C++ agent's.
_MIDDLEWARES: Final = ("auto", "dds", "rtps", "ros2", "memory", "ced")


def _verbosity(text: str) -> int:
    if text not in tuple("0123456"):
        raise argparse.ArgumentTypeError(f"{text!r} is not a verbosity (0 to 6)")
    return int(text)


_GENERAL: Final = OptionGroup()
_GENERAL.add(
    "-m", "--middleware", choices=_MIDDLEWARES, metavar="NAME", default="auto",
    help="middleware to use: auto (default: dds for topics, rtps for services; without Cyclone rtps"
    " for all), dds (Cyclone DDS), rtps (without a DDS library), ros2 (rclpy), memory (boards reach"
    " only each other), or ced (as memory, with any text as a name)",
)  # fmt: skip
_GENERAL.add("--distro", metavar="NAME", type=distro_name, help=DISTRO_HELP)
_GENERAL.add(
    "-r", "--refs", metavar="FILE", action="append",
    help="XML file of profiles that boards refer to by name; may be repeated",
)  # fmt: skip
_GENERAL.add(
    "-v", "--verbose", type=_verbosity, metavar="0-6", default=4,
    help="log level: 0 off, 1 critical, 2 error, 3 warning, 4 info (default), 5 debug, 6 trace",
)  # fmt: skip
_GENERAL.add(
    "-d", "--discovery", nargs="?", const=DEFAULT_DISCOVERY_PORT, type=port, metavar="PORT",
    help="answer boards that search for an agent by multicast"
    f" (default port: {DEFAULT_DISCOVERY_PORT})",
)  # fmt: skip
_GENERAL.add("-P", "--p2p", type=int, metavar="PORT", help=argparse.SUPPRESS)
_GENERAL.add("--stop-at-eof", action="store_true", default=False, help=argparse.SUPPRESS)

# Options that may follow any of the transports.
_GROUPS: Final = (
    _GENERAL, rules.OPTIONS, admission.OPTIONS, limits.OPTIONS, state.OPTIONS, capture.OPTIONS,
    status_socket.OPTIONS,
)  # fmt: skip
_DEFAULTS: Final[dict[str, Any]] = {
    name: default for group in _GROUPS for name, default in group.defaults.items()
}
_EPILOG: Final = """\
'uros agent TRANSPORT --help' shows the options. One agent can serve several transports:

  uros agent udp4 --port 8888
  uros agent serial --dev /dev/ttyACM0 --baudrate 921600
  uros agent udp4 --port 8888 tcp4 --port 8888 serial --dev /dev/ttyUSB0 -v 5

'uros agent status' shows the state of a running agent.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the transports and their options."""
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = _EPILOG
    common = argparse.ArgumentParser(add_help=False)
    for group in _GROUPS:
        group.declare(common)
    transports = parser.add_subparsers(dest="transport", metavar="TRANSPORT")
    for name, transport in TRANSPORTS.items():
        subparser = transports.add_parser(
            name, parents=[common], help=transport.help, description=f"serve {transport.help}"
        )
        transport.add_options(subparser)
        # Not REMAINDER, which would also take the options that follow the positional argument of
        # ``custom``.
        more = subparser.add_argument(
            "more", nargs=argparse.PARSER, default=[], metavar="TRANSPORT",
            help="another transport with its options",
        )  # fmt: skip
        more.required = False
    status.add_parser(transports)
    parser.set_defaults(parse_more=parser.parse_args, usage_error=parser.error)


def run(args: argparse.Namespace) -> int:
    """Serve until a signal ends the agent.

    Returns:
        The exit status.

    Raises:
        ToolError: An option is wrong, or a transport cannot be used.
    """
    from ...agent.objects.xml_profiles import ProfileError
    from ...agent.policy.rules import ConfigError
    from ...agent.transports.base import TransportError

    if args.transport is None:
        args.usage_error(
            f"name a transport ({', '.join(TRANSPORTS)}), such as: uros agent udp4 --port 8888"
        )
    if args.transport == status.NAME:
        return status.run(args)
    parts = _parts(args)
    try:
        options = _common(parts)
        use_distro(options.distro)
        return _serve(options, parts)
    except TransportError as error:
        raise ToolError(error.strerror or str(error)) from error
    except (ProfileError, ConfigError) as error:
        raise ToolError(str(error)) from error


def _parts(args: argparse.Namespace) -> list[argparse.Namespace]:
    """Split the command line into parts, each a transport with its options."""
    parse: Callable[[list[str]], argparse.Namespace] = args.parse_more
    parts = [args]
    while parts[-1].more:
        parts.append(parse(parts[-1].more))
        if parts[-1].transport == status.NAME:
            raise ToolError("status is not a transport: use 'uros agent status' alone")
    return parts


def _common(parts: list[argparse.Namespace]) -> argparse.Namespace:
    """Merge the agent's options of all parts: join lists, else keep the last value."""
    options = argparse.Namespace(**_DEFAULTS)
    for part in parts:
        for name, default in _DEFAULTS.items():
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
    from ...middleware import cyclone_package, open_middleware

    references = References()
    for file in options.refs:
        references.load(file)
    client_rules = rules.make_rules(options)
    admitted = admission.make_admission(options, client_rules)
    transports = [transport for part in parts for transport in make(part)]
    if options.discovery is not None:
        transports.append(make_discovery(options.discovery, transports))
    domain_of_agent = _domain_of_agent()
    middleware = open_middleware(options.middleware)
    log = Log(options.verbose)
    agent = Agent(
        middleware, log, references, domain_of_agent, options.domain, client_rules,
        admitted, options.dead_time, limits.make_limits(options),
    )  # fmt: skip
    server = Server(agent, transports)
    _stop_on_signals(server)  # before the first log line: a parent may wait for it to signal us
    watchdog = Watchdog(server, log)
    log(INFO, "Root", "set_verbose_level", "logger setup", f"verbose_level: {options.verbose}")
    if options.p2p is not None:
        log(WARNING, "Root", "main", "option ignored", "--p2p is not supported")
    if options.domain is not None:
        log(INFO, "Root", "main", "domain overridden", f"domain_id: {options.domain}")
    elif domain_of_agent:
        log(INFO, "Root", "main", "domain of the agent", f"domain_id: {domain_of_agent} (for 255)")
    if options.middleware == "auto" and (why := cyclone_package.why_missing()):
        log(INFO, "Root", "main", "RTPS in Python", f"{why}: topics and services use rtps")
    if options.middleware == "rtps":
        log(INFO, "Root", "main", "RTPS in Python", "in earlier versions -m rtps meant dds")
    messages = capture.open_capture(options, agent)
    store = state.make_session_store(options, log)
    if store is not None:
        server.attachments.append(store)
    status_socket.attach(options, server)
    if options.stop_at_eof:
        threading.Thread(target=_stop_at_eof, args=(server,), daemon=True).start()
    # What is there by now stays. Full collections of it would take 10 ms each, in which no board is
    # served.
    gc.collect()
    gc.freeze()
    watchdog.start()
    try:
        server.run()
        log(INFO, "Server", "stop", "server stopped")
    finally:
        watchdog.stop()
        if messages is not None:
            messages.close()
        log.close()
    return 0


def _domain_of_agent() -> int:
    """Return the domain of boards that ask for 255, which means the agent's domain."""
    text = os.environ.get("XRCE_DOMAIN_ID_OVERRIDE") or "0"
    try:
        return domain(text)
    # int() raises ValueError for a text of more than 4300 digits.
    except (argparse.ArgumentTypeError, ValueError) as error:
        raise ToolError(f"XRCE_DOMAIN_ID_OVERRIDE: {error}") from error


def _stop_at_eof(server: Server) -> None:
    """Stop when the parent process ends, which closes our standard input."""
    while os.read(0, 4096):  # not sys.stdin, whose lock this daemon thread would hold at exit
        pass
    server.stop()


def _stop_on_signals(server: Server) -> None:
    """Stop at SIGINT, SIGTERM, and SIGHUP unless nohup ignores it.

    SIGHUP reloads nothing, because rules files and certificates are read again when they change. It
    does not rotate the log: the program that reads standard output does that.
    """
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: server.stop())
    hangup = getattr(signal, "SIGHUP", None)  # not on Windows
    if hangup is not None and signal.getsignal(hangup) != signal.SIG_IGN:
        signal.signal(hangup, lambda *_: server.stop())
