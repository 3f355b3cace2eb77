"""Cyclone's configuration from the environment, as rmw_cyclonedds reads it.

A user's own ``CYCLONEDDS_URI`` comes last and so has the last word.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from xml.sax.saxutils import quoteattr

from ..base import MiddlewareError

RANGES = ("OFF", "LOCALHOST", "SUBNET", "SYSTEM_DEFAULT")

# Two hundred ROS processes on one machine; RTPS ports allow no more.
_MAX_PARTICIPANT_INDEX = 200

# Fast DDS knows only by a key hash which endpoint or participant says farewell, and Cyclone leaves
# it out of its own accord: endpoints would be listed there for good, participants for ten seconds
# more. ROS topics have no keys, so it concerns nothing but discovery.
#
# Deleting a writer waits until all has been acknowledged, and the agent's one thread with it: for
# Cyclone's whole second, where a reader stands still. Readers that are well answer in less.
_INTERNAL = (
    "<Internal><GenerateKeyhash>true</GenerateKeyhash>"
    "<WriterLingerDuration>50 ms</WriterLingerDuration></Internal>"
)

# Fast DDS (vendor 1.15) from ROS 2 Kilted on tells of its types, and answers questions about them
# to everybody. Cyclone takes its description of a sequence for a fault, holds each type that has
# one for invalid from then on, and lets no further endpoint of that type in. Ours tell of no types,
# so they match by name anyway.
_COMPATIBILITY = (
    "<Compatibility><IgnoreTypeInformation>1.15</IgnoreTypeInformation></Compatibility>"
)


def discovery_range(environment: Mapping[str, str]) -> str:
    """How far discovery reaches: one of :data:`RANGES`.

    ``ROS_LOCALHOST_ONLY=1`` counts where ``ROS_AUTOMATIC_DISCOVERY_RANGE`` is
    not set. Raises MiddlewareError for a value that does not exist.
    """
    value = environment.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "").upper()
    if not value:
        return "LOCALHOST" if environment.get("ROS_LOCALHOST_ONLY") == "1" else "SUBNET"
    if value not in RANGES:
        raise MiddlewareError(
            f"ROS_AUTOMATIC_DISCOVERY_RANGE={value!r} does not exist;"
            f" set it to one of {', '.join(RANGES)}"
        )
    return value


def stays_on_loopback(environment: Mapping[str, str]) -> bool:
    """Whether nothing of a domain can leave this machine."""
    if discovery_range(environment) != "LOCALHOST":
        return False
    words = _own_words(environment)
    return len(_INTERFACE.findall(words)) == len(_LOOPBACK.findall(words))


# Elements of Cyclone's configuration that choose an interface, and those that choose loopback.
_INTERFACE = re.compile(r"<\s*(?:NetworkInterface\b|NetworkInterfaceAddress\s*>)", re.IGNORECASE)
_LOOPBACK = re.compile(
    r"<\s*NetworkInterface\b[^>]*(?:name\s*=\s*[\"']lo[\"']|address\s*=\s*[\"']127\.)"
    r"|<\s*NetworkInterfaceAddress\s*>\s*(?:lo\s*<|127\.)",
    re.IGNORECASE,
)


def _own_words(environment: Mapping[str, str]) -> str:
    """The text of the user's configuration, of files that it names too."""
    words = []
    for part in _parts(environment.get("CYCLONEDDS_URI", "")):
        if not part.startswith("<"):
            try:
                part = Path(part.removeprefix("file://")).read_text("utf-8", "replace")
            except OSError:
                pass  # Cyclone will say so
        words.append(part)
    return "\n".join(words)


def _parts(uri: str) -> list[str]:
    """What CYCLONEDDS_URI lists: XML, or the names of files."""
    if "<" in uri:
        before, _, xml = uri.partition("<")
        return [it for it in before.split(",") if it.strip()] + ["<" + xml]
    return [it.strip() for it in uri.split(",") if it.strip()]


def config_xml(environment: Mapping[str, str], pid: int) -> str:
    """The configuration of a domain, in the form of ``CYCLONEDDS_URI``."""
    reach = discovery_range(environment)
    peers = [peer for peer in environment.get("ROS_STATIC_PEERS", "").split(";") if peer]
    general = ""
    discovery = "<ParticipantIndex>auto</ParticipantIndex>"
    discovery += f"<MaxAutoParticipantIndex>{_MAX_PARTICIPANT_INDEX}</MaxAutoParticipantIndex>"
    if reach == "OFF":
        general = "<AllowMulticast>false</AllowMulticast>"
        discovery = "<ParticipantIndex>none</ParticipantIndex>"
        discovery += f"<Tag>ros_discovery_off_{pid}</Tag>"
        peers = []
    elif reach == "LOCALHOST":
        general = "<AllowMulticast>false</AllowMulticast>"
        if not _INTERFACE.search(_own_words(environment)):
            general += '<Interfaces><NetworkInterface address="127.0.0.1"/></Interfaces>'
        peers = ["127.0.0.1", *peers]
    elif reach == "SYSTEM_DEFAULT":
        peers = []
    if peers:
        listed = "".join(f"<Peer Address={quoteattr(peer)}/>" for peer in peers)
        discovery += f"<Peers>{listed}</Peers>"
    ours = (
        f"<CycloneDDS><Domain><General>{general}</General>"
        f"<Discovery>{discovery}</Discovery>{_INTERNAL}{_COMPATIBILITY}</Domain></CycloneDDS>"
    )
    return ",".join(part for part in (ours, environment.get("CYCLONEDDS_URI", "")) if part)


# Bytes of a Gid in ros_discovery_info: 24 up to Humble, 16 from Iron on.
SHORT_GID = 16
LONG_GID = 24
_GID_SIZES = {
    **dict.fromkeys(("foxy", "galactic", "humble"), LONG_GID),
    **dict.fromkeys(("iron", "jazzy", "kilted", "lyrical", "rolling"), SHORT_GID),
}


def gid_size(environment: Mapping[str, str]) -> int | None:
    """Bytes of a Gid for the ROS that ROS_DISTRO names; None where it names none we know."""
    return _GID_SIZES.get(environment.get("ROS_DISTRO", "").strip().lower())
