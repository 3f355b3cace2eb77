"""Cyclone's configuration from the environment, as rmw_cyclonedds reads it.

A user's own ``CYCLONEDDS_URI`` comes last, and so overrides what is set here.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from xml.etree.ElementTree import Element, tostring

from .. import cyclonedds_uri
from ..environment import discovery_range

# Two hundred ROS processes on one machine; RTPS ports allow no more.
_MAX_PARTICIPANT_INDEX = 200

# Fast DDS needs the key hash to know which endpoint or participant a dispose is about, and Cyclone
# does not send one by default: deleted endpoints would stay listed in Fast DDS, participants for
# ten seconds more. ROS topics have no keys, so it concerns discovery alone.
#
# Deleting a writer waits until its samples are acknowledged, and the agent's one thread waits with
# it. If a reader hangs, that would take Cyclone's default of 1 s. A reader that works answers in
# less than 50 ms.
_INTERNAL = (
    "<Internal><GenerateKeyhash>true</GenerateKeyhash>"
    "<WriterLingerDuration>50 ms</WriterLingerDuration></Internal>"
)

# Fast DDS (vendor 1.15) from ROS 2 Kilted on announces type information and answers type look-ups
# of everybody. Cyclone considers its description of a sequence invalid, then every type with one,
# and refuses each further endpoint of such a type. Ours announce no type information, so types
# match by name in any case.
_COMPATIBILITY = (
    "<Compatibility><IgnoreTypeInformation>1.15</IgnoreTypeInformation></Compatibility>"
)


def stays_on_loopback(environment: Mapping[str, str]) -> bool:
    """Return whether no packet of a domain can leave this machine."""
    if discovery_range(environment) != "LOCALHOST":
        return False
    text = _user_configuration(environment)
    return len(_INTERFACE.findall(text)) == len(_LOOPBACK.findall(text))


# Elements of Cyclone's configuration that choose an interface, and those that choose loopback.
_INTERFACE = re.compile(r"<\s*(?:NetworkInterface\b|NetworkInterfaceAddress\s*>)", re.IGNORECASE)
_LOOPBACK = re.compile(
    r"<\s*NetworkInterface\b[^>]*(?:name\s*=\s*[\"']lo[\"']|address\s*=\s*[\"']127\.)"
    r"|<\s*NetworkInterfaceAddress\s*>\s*(?:lo\s*<|127\.)",
    re.IGNORECASE,
)


def _user_configuration(environment: Mapping[str, str]) -> str:
    """Return the text of the user's configuration, with that of the files it names."""
    texts = []
    for part in cyclonedds_uri.parts(environment.get(cyclonedds_uri.NAME, "")):
        try:
            texts.append(cyclonedds_uri.text_of(part))
        except OSError:
            texts.append(part)  # Cyclone will say so
    return "\n".join(texts)


def config_xml(environment: Mapping[str, str], pid: int) -> str:
    """Return the configuration of a domain in the form of ``CYCLONEDDS_URI``.

    Args:
        environment: The environment variables.
        pid: This process; it makes the discovery tag unique if the range is OFF.

    Raises:
        MiddlewareError: The discovery range does not exist.
    """
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
        if not _INTERFACE.search(_user_configuration(environment)):
            general += '<Interfaces><NetworkInterface address="127.0.0.1"/></Interfaces>'
        peers = ["127.0.0.1", *peers]
    elif reach == "SYSTEM_DEFAULT":
        peers = []
    if peers:
        # xml.sax.saxutils would quote the text alone, but loads 1.3 MB of HTTP and mail.
        listed = "".join(tostring(Element("Peer", Address=peer), "unicode") for peer in peers)
        discovery += f"<Peers>{listed}</Peers>"
    ours = (
        f"<CycloneDDS><Domain><General>{general}</General>"
        f"<Discovery>{discovery}</Discovery>{_INTERNAL}{_COMPATIBILITY}</Domain></CycloneDDS>"
    )
    return ",".join(part for part in (ours, environment.get(cyclonedds_uri.NAME, "")) if part)
