"""``uros multicast receive``: wait for one UDP multicast datagram."""

from __future__ import annotations

import argparse

from ...printable import printable
from .group import add_group, receive, receiver


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros multicast receive``."""
    add_group(parser)


def run(args: argparse.Namespace) -> int:
    """Print the first datagram that comes, or end by Ctrl-C."""
    try:
        with receiver(args.group, args.port) as sock:
            print("Waiting for UDP multicast datagram...", flush=True)
            text, sender = receive(sock)
    except KeyboardInterrupt:
        return 0  # as in ros2
    print(f"Received from {sender}: '{printable(text)}'")
    return 0
