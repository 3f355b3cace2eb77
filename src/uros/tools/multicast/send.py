"""``uros multicast send``: send one UDP multicast datagram."""

from __future__ import annotations

import argparse

from .group import add_group, send, ttl


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros multicast send``."""
    add_group(parser)
    parser.add_argument(
        "--ttl", metavar="N", type=ttl,
        help="routers that may pass it on, plus one (default: the system's, mostly 1)",
    )  # fmt: skip


def run(args: argparse.Namespace) -> int:
    """Send one datagram."""
    print("Sending one UDP multicast datagram...")
    send(args.group, args.port, args.ttl)
    return 0
