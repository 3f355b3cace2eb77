"""Options, joining the domain and hints, for the verbs on a ROS 2 network."""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterable
from typing import TYPE_CHECKING, Final

from .agent.unseen import agents_reasons, why_alone
from .errors import did_you_mean

if TYPE_CHECKING:
    from ..host.network import Network


AGENT_HELP: Final = (
    "the agent's process id, or its configuration file: the path, or the name without .toml"
)
DISTRO_HELP: Final = (
    "ROS 2 distribution whose interface definitions to use, such as humble (default: ROS_DISTRO,"
    " or the newest one that uros knows)"
)


# Seconds to wait for an answer of a node.
ANSWER_SECONDS: Final = 5.0


def add_common(parser: argparse.ArgumentParser) -> None:
    """Declare the options of every verb that joins a domain."""
    parser.add_argument(
        "--domain",
        metavar="N",
        type=domain,
        help="ROS domain (default: ROS_DOMAIN_ID, or 0)",
    )
    add_interfaces(parser)
    parser.add_argument(
        "--spin-time",
        metavar="S",
        type=positive_float,
        help="seconds to wait for discovery (default: until nothing new is found)",
    )
    parser.add_argument("--no-daemon", action="store_true", help=argparse.SUPPRESS)


def add_interfaces(parser: argparse.ArgumentParser) -> None:
    """Declare ``--interfaces`` and ``--distro``, which `know_interfaces` applies."""
    add_distro(parser)
    parser.add_argument(
        "--interfaces",
        metavar="DIR",
        action="append",
        default=[],
        help="folder with further .msg, .srv and .action files, besides those of UROS_INTERFACES;"
        " may be repeated",
    )


def distro_name(text: str) -> str:
    """Parse the name of a distribution."""
    from ..interfaces.distro import NAMES

    name = text.strip().lower()
    if name not in NAMES:
        known = ", ".join(NAMES)
        raise argparse.ArgumentTypeError(f"unknown ROS 2 distribution {text!r}; known are {known}")
    return name


def add_distro(parser: argparse.ArgumentParser) -> None:
    """Declare ``--distro``, which `know_distro` applies."""
    parser.add_argument("--distro", metavar="NAME", type=distro_name, help=DISTRO_HELP)


def know_distro(args: argparse.Namespace) -> None:
    """Use the definitions of ``--distro`` or ROS_DISTRO, also in child processes.

    Raises:
        InterfaceError: ROS_DISTRO names an unknown distribution.
    """
    from ..interfaces.distro import chosen

    use_distro(args.distro)
    chosen()


def use_distro(name: str | None) -> None:
    """Use a distribution's definitions and GID size, unless ``name`` is empty."""
    from ..interfaces.distro import use

    if name:
        use(name)
        os.environ["ROS_DISTRO"] = name


def know_interfaces(args: argparse.Namespace) -> None:
    """Apply ``--distro`` and ``--interfaces``, and check the variable UROS_INTERFACES.

    Raises:
        InterfaceError: A folder or a definition is wrong.
    """
    know_distro(args)
    if "UROS_INTERFACES" in os.environ:
        from ..interfaces import registry

        registry.check_variable()
    if args.interfaces:
        from ..interfaces import add_folder

        for folder in args.interfaces:
            add_folder(folder)


def add_engine(parser: argparse.ArgumentParser) -> None:
    """Declare ``--engine``, on which the firmware of virtual boards runs."""
    parser.add_argument(
        "--engine",
        choices=("cpython", "micropython"),
        default="cpython",
        help="interpreter of the firmware: cpython (default), or micropython, which needs Node",
    )


def add_topic(parser: argparse.ArgumentParser, nargs: str | None = None) -> None:
    """Declare the positional argument ``topic``."""
    parser.add_argument(
        "topic",
        metavar="TOPIC",
        type=topic_name,
        nargs=nargs,
        help="name of the topic, such as /chatter",
    )


def add_service(parser: argparse.ArgumentParser) -> None:
    """Declare the positional argument ``service``."""
    parser.add_argument(
        "service", metavar="NAME", type=service_name, help="name of the service, such as /reset"
    )


def add_node(parser: argparse.ArgumentParser, nargs: str | None = None) -> None:
    """Declare the positional argument ``node``."""
    parser.add_argument(
        "node", metavar="NODE", nargs=nargs, help="full name of the node, such as /talker"
    )


def add_served_node(parser: argparse.ArgumentParser, nargs: str | None = None) -> None:
    """Declare ``node`` and the options of the verbs that call the services of nodes."""
    add_node(parser, nargs)
    add_common(parser)
    parser.add_argument(
        "--include-hidden-nodes", action="store_true",
        help="hidden nodes too, whose names begin with _, where NODE is not given",
    )  # fmt: skip
    parser.add_argument(
        "--timeout", metavar="S", type=positive_float,
        help="seconds to wait for the node after discovery (default: 1), and for each of its"
        f" answers (default: {ANSWER_SECONDS:g})",
    )  # fmt: skip


def add_node_name(parser: argparse.ArgumentParser) -> None:
    """Declare ``-n/--node-name``, to pass to `join`."""
    parser.add_argument(
        "-n", "--node-name", metavar="NAME", type=node_name,
        help="name of the command's own node (default: a hidden one, _uros_ and a number)",
    )  # fmt: skip


def add_action(parser: argparse.ArgumentParser) -> None:
    """Declare the positional argument ``action``."""
    parser.add_argument(
        "action", metavar="NAME", type=action_name, help="name of the action, such as /fibonacci"
    )


def add_type(parser: argparse.ArgumentParser) -> None:
    """Declare the positional argument ``type``, of any kind."""
    parser.add_argument(
        "type", metavar="TYPE",
        help="name of a message, service or action type, such as std_msgs/msg/Header",
    )  # fmt: skip


# --- values on the command line -----------------------------------------------------


def domain(text: str) -> int:
    """Parse a ROS domain."""
    from ..middleware.base import MAX_DOMAIN

    if not text.isdecimal() or int(text) > MAX_DOMAIN:
        raise argparse.ArgumentTypeError(f"{text!r} is not a domain; give 0 to {MAX_DOMAIN}")
    return int(text)


def positive_float(text: str) -> float:
    """Parse a number above 0."""
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"{text!r} is not a number above 0")
    return value


def unsigned_float(text: str) -> float:
    """Parse a number of 0 or more."""
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0.0 <= value < float("inf"):
        raise argparse.ArgumentTypeError(f"{text!r} is not a number of 0 or more")
    return value


def positive_int(text: str) -> int:
    """Parse an integer above 0."""
    if not text.isdecimal() or not int(text):
        raise argparse.ArgumentTypeError(f"{text!r} is not an integer above 0")
    return int(text)


def agent_choice(text: str) -> int | str:
    """Parse what ``--agent`` takes: a process id, or the name of a configuration file."""
    if text.isdecimal():
        return positive_int(text)
    if not text or text.startswith("-"):
        raise argparse.ArgumentTypeError(f"{text!r} is neither a pid nor a configuration file")
    return text


def unsigned_int(text: str) -> int:
    """Parse an integer from 0 on."""
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"{text!r} is not an integer of 0 or more")
    return int(text)


def topic_name(text: str) -> str:
    """Parse a topic name and make it absolute."""
    return _full_name(text, "a topic")


def node_name(text: str) -> str:
    """Parse the name of a node, without a namespace."""
    from .. import names

    if "/" in text or not names.is_valid(f"/{text}"):
        raise argparse.ArgumentTypeError(
            f"{text!r} is not a node name: use letters, digits and single _, and no digit first"
        )
    return text


def service_name(text: str) -> str:
    """Parse a service name and make it absolute."""
    return _full_name(text, "a service")


def action_name(text: str) -> str:
    """Parse an action name and make it absolute."""
    return _full_name(text, "an action")


def _full_name(text: str, what: str) -> str:
    from .. import names

    name = names.absolute(text)
    if not names.is_valid(name):
        raise argparse.ArgumentTypeError(
            f"{text!r} is not {what} name: use letters, digits and single _ between slashes, and"
            " no digit behind a slash"
        )
    return name


# --- the network ------------------------------------------------------------------


def join(args: argparse.Namespace, middleware: str = "auto", node_name: str = "") -> Network:
    """Apply ``--interfaces`` and join the domain. Nothing is discovered yet.

    Args:
        args: The command line.
        middleware: The middleware's name.
        node_name: The name of the command's node; by default a hidden one.
    """
    from ..host.network import Network
    from ..middleware.environment import environment_domain

    number = args.domain if args.domain is not None else environment_domain()
    know_interfaces(args)
    return Network(number, middleware, node_name)


def discover(network: Network, args: argparse.Namespace) -> None:
    """Discover the domain for ``--spin-time``, or until nothing new is found."""
    if args.spin_time is None:
        network.settle()
    else:
        network.spin(lambda: False, args.spin_time)


_ITS_OWN_DOMAIN: Final = "a board chooses its domain itself: 'uros agent status' shows it"


def remedy(network: Network, name: str, known: Iterable[str]) -> str:
    """Return the end of a message about an unknown name: similar names, or why there are none."""
    close = "" if network.alone else did_you_mean(name, known)
    if close:
        return f" in domain {network.domain}{close}"
    # Of several agents, the one whose boards are elsewhere explains most.
    reasons = sorted(agents_reasons(network.domain), key=lambda reason: "--domain" not in reason)
    if network.alone:
        return "; ".join([f": {why_alone(network)}", *reasons[:1]])
    return "; ".join([f" in domain {network.domain}", *(reasons[:1] or [_ITS_OWN_DOMAIN])])
