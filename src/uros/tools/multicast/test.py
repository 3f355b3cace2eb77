"""``uros multicast test``: send and receive on each network interface of this machine."""

from __future__ import annotations

import argparse
import sys

from ..doctor.command import print_finding
from ..doctor.finding import PROBLEM
from ..doctor.network import check_interface, no_network
from ..errors import ToolError
from .group import add_group


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros multicast test``."""
    add_group(parser)


def run(args: argparse.Namespace) -> int:
    """Print for each interface whether a datagram to the group comes back, and a fix if not.

    Nothing leaves the machine.

    Returns:
        1 if an interface is at fault, else 0.

    Raises:
        ToolError: The interfaces of this system cannot be listed.
    """
    from ...addresses import interfaces

    if sys.platform != "linux":
        raise ToolError(
            "interfaces are listed on Linux only; run 'uros multicast receive' in one terminal and"
            " 'uros multicast send' in another"
        )
    up = interfaces()
    findings = [
        check_interface(one, args.group, args.port)
        for one in up
        if one.address and not one.is_loopback
    ] or [no_network(up)]
    for finding in findings:
        print_finding(finding)
    return int(any(finding.state == PROBLEM for finding in findings))
