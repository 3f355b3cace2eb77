"""What the verbs that look at a network have in common: options, joining, what to say."""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterable
from typing import TYPE_CHECKING, Final

from .errors import did_you_mean

if TYPE_CHECKING:
    from ..host.network import Network


DISTRO_HELP: Final = (
    "ROS 2 distribution whose interface definitions to use, such as humble (default: ROS_DISTRO,"
    " or the newest one that uros knows)"
)


def add_common(parser: argparse.ArgumentParser) -> None:
    """The options of every verb that joins a domain."""
    parser.add_argument(
        "--domain",
        metavar="N",
        type=domain,
        help="ROS domain to look at (default: ROS_DOMAIN_ID, or 0)",
    )
    add_interfaces(parser)
    parser.add_argument(
        "--spin-time",
        metavar="S",
        type=positive_float,
        help="discover for exactly so many seconds (default: until nothing new comes)",
    )
    parser.add_argument("--no-daemon", action="store_true", help=argparse.SUPPRESS)


def add_interfaces(parser: argparse.ArgumentParser) -> None:
    """``--interfaces`` and ``--distro``; `know_interfaces` does what they say."""
    add_distro(parser)
    parser.add_argument(
        "--interfaces",
        metavar="DIR",
        action="append",
        default=[],
        help="folder with .msg, .srv and .action files to know besides; may be repeated",
    )


def distro_name(text: str) -> str:
    """One of those whose definitions there are."""
    from ..interfaces.distro import NAMES

    name = text.strip().lower()
    if name not in NAMES:
        known = ", ".join(NAMES)
        raise argparse.ArgumentTypeError(f"no definitions of {text!r}; there are {known}")
    return name


def add_distro(parser: argparse.ArgumentParser) -> None:
    """Declare ``--distro``, which `know_distro` applies."""
    parser.add_argument("--distro", metavar="NAME", type=distro_name, help=DISTRO_HELP)


def know_distro(args: argparse.Namespace) -> None:
    """Take the definitions of ``--distro`` or ROS_DISTRO, here and in processes that are started.
    Raises InterfaceError.
    """
    from ..interfaces.distro import chosen

    use_distro(args.distro)
    chosen()


def use_distro(name: str | None) -> None:
    """Take a distribution's definitions, and the size of its Gids, where it has a name."""
    from ..interfaces.distro import use

    if name:
        use(name)
        os.environ["ROS_DISTRO"] = name


def know_interfaces(args: argparse.Namespace) -> None:
    """Make the definitions of ``--distro`` and ``--interfaces`` known. Raises InterfaceError."""
    know_distro(args)
    if args.interfaces:
        from ..interfaces import add_folder

        for folder in args.interfaces:
            add_folder(folder)


def add_engine(parser: argparse.ArgumentParser) -> None:
    """What a virtual board's firmware runs on."""
    parser.add_argument(
        "--engine",
        choices=("cpython", "micropython"),
        default="cpython",
        help="what runs the firmware: cpython (default), or micropython, which needs Node",
    )


def add_topic(parser: argparse.ArgumentParser, nargs: str | None = None) -> None:
    """The positional argument ``topic``."""
    parser.add_argument(
        "topic",
        metavar="TOPIC",
        type=topic_name,
        nargs=nargs,
        help="name of the topic, such as /chatter",
    )


def add_service(parser: argparse.ArgumentParser) -> None:
    """The positional argument ``service``."""
    parser.add_argument(
        "service", metavar="NAME", type=service_name, help="name of the service, such as /reset"
    )


def add_type(parser: argparse.ArgumentParser) -> None:
    """The positional argument ``type``: of any kind."""
    parser.add_argument(
        "type", metavar="TYPE", help="name of a message, service or action: std_msgs/msg/Header"
    )


# --- values on the command line -----------------------------------------------------


def domain(text: str) -> int:
    from ..middleware.base import MAX_DOMAIN

    if not text.isdecimal() or int(text) > MAX_DOMAIN:
        raise argparse.ArgumentTypeError(f"{text!r} is no domain; give 0 to {MAX_DOMAIN}")
    return int(text)


def positive_float(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"{text!r} is no number above 0")
    return value


def positive_int(text: str) -> int:
    if not text.isdecimal() or not int(text):
        raise argparse.ArgumentTypeError(f"{text!r} is no whole number above 0")
    return int(text)


def unsigned_int(text: str) -> int:
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"{text!r} is no whole number from 0 on")
    return int(text)


def topic_name(text: str) -> str:
    """The absolute name; the first slash may be left away."""
    from .. import names

    name = names.absolute(text)
    if not names.is_valid(name):
        raise argparse.ArgumentTypeError(
            f"{text!r} is no topic name: letters, digits and _ between slashes, no part beginning"
            " with a digit, no __"
        )
    return name


def service_name(text: str) -> str:
    """The same for a service."""
    from .. import names

    name = names.absolute(text)
    if not names.is_valid(name):
        raise argparse.ArgumentTypeError(
            f"{text!r} is no name of a service: letters, digits and _ between slashes, no part"
            " beginning with a digit, no __"
        )
    return name


# --- the network ------------------------------------------------------------------


def join(args: argparse.Namespace) -> Network:
    """Make the ``--interfaces`` known and join the domain; nothing is discovered yet."""
    from ..host.network import Network
    from ..middleware.base import environment_domain

    number = args.domain if args.domain is not None else environment_domain()
    know_interfaces(args)
    return Network(number)


def discover(network: Network, args: argparse.Namespace) -> None:
    """Learn what is in the domain, for ``--spin-time`` or as long as there is news."""
    if args.spin_time is None:
        network.settle()
    else:
        network.spin(lambda: False, args.spin_time)


def remedy(network: Network, name: str, known: Iterable[str]) -> str:
    """What follows "there is no such name": close ones, or why there may be none."""
    if network.alone:
        return (
            f": nobody else was found in domain {network.domain}; check --domain, ROS_DOMAIN_ID"
            " and ROS_AUTOMATIC_DISCOVERY_RANGE"
        )
    close = did_you_mean(name, known)
    if close:
        return f" in domain {network.domain}{close}"
    return (
        f" in domain {network.domain}; a board chooses its domain itself, and its agent's log"
        " says which"
    )
