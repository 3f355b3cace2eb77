"""``uros agent``: serve boards on one transport or several, with the C++ agent's options."""

from __future__ import annotations

import argparse
import gc
import os
import signal
import threading
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Final

from ..common import DISTRO_HELP, distro_name, domain, use_distro
from ..errors import ToolError, UsageError
from ..parser import Parser
from . import ament, status
from .config import check
from .options import admission, audit, capture, limits, rules, state, status_socket
from .options.group import OptionGroup
from .options.transports import DEFAULT_DISCOVERY_PORT, TRANSPORTS, make, make_discovery, port
from .reload import Reloader, Settings, has_terminal, log_replaced, make_settings

if TYPE_CHECKING:
    from ...agent.server import Server
    from .config.file import Config

# The names of middlewares on the command line, which include the C++ agent's.
_MIDDLEWARES: Final = ("auto", "dds", "rtps", "ros2", "memory", "ced")


def _verbosity(text: str) -> int:
    if text not in tuple("0123456"):
        raise argparse.ArgumentTypeError(f"{text!r} is not a verbosity (0 to 6)")
    return int(text)


_GENERAL: Final = OptionGroup()
_GENERAL.add(
    "--config", metavar="FILE",
    help="TOML file with transports, options and rules (docs/production.md); the command line wins",
)  # fmt: skip
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
    "--log-format", choices=("text", "json"), metavar="FORMAT", default="text",
    help="format of the log: text (default), or json (an object a line, docs/production.md)",
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
    audit.OPTIONS, status_socket.OPTIONS,
)  # fmt: skip
_DEFAULTS: Final[dict[str, Any]] = {
    name: default for group in _GROUPS for name, default in group.defaults.items()
}
# Before the attributes of options that come before the first transport.
_FIRST: Final = "first_"
# What may be given instead of a transport.
_VERBS: Final = (status.NAME, check.NAME, ament.NAME)
_EPILOG: Final = """\
'uros agent TRANSPORT --help' shows the options. One agent can serve several transports:

  uros agent udp4 --port 8888
  uros agent serial --dev /dev/ttyACM0 --baudrate 921600
  uros agent udp4 --port 8888 tcp4 --port 8888 serial --dev /dev/ttyUSB0 -v 5

A configuration file can hold all of it ('uros agent check FILE' checks the file):

  uros agent --config /etc/uros/agent.toml

'uros agent status' shows the state of a running agent.
"""


class _TransportParser(Parser):
    """Parses the options of one transport; what follows the name of another one is in ``more``."""

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse the options of this transport; an unknown one is an error."""
        words = list(args or ())
        end = end_of_devices(words) if "--devs" in self._option_string_actions else len(words)
        parsed, unknown = super().parse_known_args(words[:end], namespace)
        self.refuse(unknown)
        if words[end:]:
            parsed.more = words[end:]
        return parsed, unknown


def end_of_devices(words: Sequence[str]) -> int:
    """Return where the name of a transport ends the list of ``multiserial --devs``.

    An option with any number of values would take the name for another device.

    Returns:
        The index of the name, or the number of words.
    """
    within = False
    for at, word in enumerate(words):
        if word.startswith("-"):
            within = word == "-D" or (len(word) > 2 and "--devs".startswith(word))
        elif within and word in TRANSPORTS:
            return at
    return len(words)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the transports and their options."""
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = _EPILOG
    common = _TransportParser(add_help=False)
    for group in _GROUPS:
        group.declare(common)
        group.declare_hidden(parser, _FIRST, ("config",))
    transports = parser.add_subparsers(
        dest="transport", metavar="TRANSPORT", parser_class=_TransportParser
    )
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
    check.add_parser(transports)
    ament.add_parser(transports)
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

    if args.transport == status.NAME:
        return status.run(args)
    if args.transport == check.NAME:
        return check.run(args, _GROUPS)
    if args.transport == ament.NAME:
        return ament.run(args)
    parts = _parts(args)
    try:
        config = read_config(_common(parts).config)
        options = _common(parts, config)
        given = [part for part in parts if part.transport is not None]
        if not given and (config is None or not config.transports):
            instead = "" if config is None else f", or give {config.path} a [[transport]]"
            args.usage_error(
                f"name a transport ({', '.join(TRANSPORTS)}), such as: uros agent udp4 --port 8888"
                + instead
            )
        use_distro(options.distro)

        def read() -> Settings:
            """Read all files again, for a reload."""
            config = read_config(options.config)
            return make_settings(_common(parts, config), config, given)

        return _serve(make_settings(options, config, given), read)
    except TransportError as error:
        from .port_in_use import name_holder

        raise ToolError(name_holder(error.strerror or str(error))) from error
    except ConfigError as error:
        raise ToolError(error.all_faults) from error
    except ProfileError as error:
        raise ToolError(str(error)) from error


def read_config(path: str | None) -> Config | None:
    """Read the file of ``--config``, if it is given.

    Raises:
        ToolError: The file has a mistake.
        ConfigError: The file cannot be read, or is no TOML.
    """
    if path is None:
        return None
    from .config.file import Config

    config = Config(path, _GROUPS)
    if config.problems:
        problem = min(config.problems, key=lambda each: each.line)
        more = len(config.problems) - 1
        raise ToolError(f"{problem}{f' (and {more} more: uros agent check {path})' * bool(more)}")
    return config


def _parts(args: argparse.Namespace) -> list[argparse.Namespace]:
    """Split the command line into parts, each a transport with its options.

    The first part has the options before the first transport, if there are any.
    """
    parse: Callable[[list[str]], argparse.Namespace] = args.parse_more
    parts = [args] if args.transport is not None else []
    while parts and parts[-1].more:
        parts.append(parse(parts[-1].more))
        if parts[-1].transport in _VERBS:
            name = parts[-1].transport
            raise ToolError(f"{name} is not a transport: use 'uros agent {name}' alone")
    first = {
        name[len(_FIRST) :]: value for name, value in vars(args).items() if name.startswith(_FIRST)
    }
    return [argparse.Namespace(transport=None, **first), *parts] if first else parts


def _common(parts: list[argparse.Namespace], config: Config | None = None) -> argparse.Namespace:
    """Merge the agent's options of all parts: join lists, else keep the last value.

    Options of the configuration count where the command line has none. The rule for all boards is
    the command line's alone: the one of the configuration has its own place in the order of rules.
    """
    given = argparse.Namespace()
    for part in parts:
        for name, default in _DEFAULTS.items():
            if hasattr(part, name):
                value = getattr(part, name)
                joined = getattr(given, name, []) + value if isinstance(default, list) else value
                setattr(given, name, joined)
    configured = (
        {}
        if config is None
        else {name: value for name, value in config.options.items() if name not in rules.RULE}
    )
    return argparse.Namespace(**{**_DEFAULTS, **configured, **vars(given)})


def _serve(settings: Settings, read: Callable[[], Settings]) -> int:
    from ...agent.agent import Agent
    from ...agent.log import INFO, WARNING, Log
    from ...agent.objects.xml_profiles import References
    from ...agent.server import Server
    from ...agent.watchdog import Watchdog
    from ...middleware import cyclone_package, open_middleware

    options = settings.options
    references = References()
    for file in options.refs:
        references.load(file)
    transports = [transport for part in settings.transports for transport in make(part)]
    if options.discovery is not None:
        transports.append(make_discovery(options.discovery, transports))
    domain_of_agent = _domain_of_agent()
    middleware = open_middleware(options.middleware)
    log = Log(options.verbose, as_json=options.log_format == "json")
    agent = Agent(
        middleware, log, references, domain_of_agent, options.domain,
        settings.rules, settings.admission, options.dead_time, limits.make_limits(options),
    )  # fmt: skip
    server = Server(agent, transports)
    server.config_file = os.path.abspath(options.config) if options.config else ""
    # Before the first log line: a parent may wait for it to signal us.
    _act_on_signals(server, Reloader(server, settings, read))
    watchdog = Watchdog(server, log)
    log(INFO, "Root", "set_verbose_level", "logger setup", f"verbose_level: {options.verbose}")
    log_replaced(log, settings)
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
    server.troubles.append(log.trouble)
    messages = capture.open_capture(options, agent)
    if messages is not None:
        server.troubles.append(messages.trouble)
    store = state.make_session_store(options, log)
    if store is not None:
        server.attachments.append(store)
        server.troubles.append(store.trouble)
    status_socket.attach(options, server)
    audit.attach(options, server)
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
        raise UsageError(f"XRCE_DOMAIN_ID_OVERRIDE: {error}") from error


def _stop_at_eof(server: Server) -> None:
    """Stop when the parent process ends, which closes our standard input."""
    while os.read(0, 4096):  # not sys.stdin, whose lock this daemon thread would hold at exit
        pass
    server.stop()


def _act_on_signals(server: Server, reloader: Reloader) -> None:
    """Stop at SIGINT and SIGTERM; reload at SIGHUP, or stop if it says that our terminal is closed.

    Under nohup, SIGHUP stays ignored. It does not rotate the log: the program that reads standard
    output does that.
    """
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: server.stop())
    hangup = getattr(signal, "SIGHUP", None)  # not on Windows
    if hangup is None or signal.getsignal(hangup) == signal.SIG_IGN:
        return
    had_terminal = has_terminal()

    def hung_up(*_: object) -> None:
        if had_terminal and not has_terminal():
            server.stop()
        else:
            reloader.request()

    signal.signal(hangup, hung_up)
