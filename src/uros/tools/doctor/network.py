"""Discovery: what the environment allows, and whether multicast works on the interfaces."""

from __future__ import annotations

import errno
import secrets
import select
import socket
import struct
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final
from xml.etree import ElementTree

from ...middleware.base import MiddlewareError
from .finding import Finding, note, ok, problem, unknown

GROUP: Final = "239.255.0.1"  # where DDS participants look for each other
_WAIT: Final = 0.5
_SIOCGIFFLAGS, _SIOCGIFADDR = 0x8913, 0x8915
_UP, _LOOPBACK, _POINT_TO_POINT, _RUNNING, _MULTICAST = 0x1, 0x8, 0x10, 0x40, 0x1000
_UFW: Final = Path("/etc/ufw/ufw.conf")
# Interfaces that containers and virtual machines stand behind: no board is reached by them.
_INNER: Final = ("docker", "veth", "br-", "virbr", "lxc", "cni", "flannel", "cali")


SHELL: Final = "this shell"


def spdp_port(domain: int) -> int:
    """The port of discovery by multicast."""
    return 7400 + 250 * domain


# --- the environment ----------------------------------------------------------------------------


def check_range(environment: Mapping[str, str], whose: str = SHELL) -> list[Finding]:
    """How far discovery reaches. ``whose`` environment it is: this shell's, or an agent's."""
    from ...middleware.dds.config import discovery_range

    name = (
        "ROS_AUTOMATIC_DISCOVERY_RANGE"
        if environment.get("ROS_AUTOMATIC_DISCOVERY_RANGE")
        else "ROS_LOCALHOST_ONLY"
    )
    setting = f"{name}={environment.get(name, '')}"
    again = "" if whose == SHELL else ", and start it again"
    try:
        reach = discovery_range(environment)
    except MiddlewareError as error:
        return [problem("discovery", f"in {whose}, {error}", f"unset {name}{again}")]
    if reach == "OFF":
        return [
            problem(
                "discovery",
                f"{whose} has {setting}: its nodes are found by nobody and find nobody",
                f"unset {name}{again}",
            )
        ]
    if reach == "LOCALHOST":
        peers = environment.get("ROS_STATIC_PEERS", "")
        besides = f", but for the peers {peers}" if peers else ""
        return [
            note(
                "discovery",
                f"{whose} has {setting}: nodes on other machines are not seen{besides}",
                f"if there are such: unset {name}{again}",
            )
        ]
    if reach == "SYSTEM_DEFAULT":
        return [note("discovery", f"{whose} leaves discovery to the DDS configuration ({setting})")]
    return [ok("discovery", f"{whose} looks for nodes on the whole subnet")]


def check_cyclone(environment: Mapping[str, str], whose: str = SHELL) -> list[Finding]:
    """What CYCLONEDDS_URI does to discovery, where somebody has set it."""
    from ...middleware.dds import config

    uri = environment.get("CYCLONEDDS_URI", "")
    if not uri.strip():
        return []
    findings = []
    roots = []
    for part in config._parts(uri):
        text = part
        if not part.startswith("<"):
            path = Path(part.removeprefix("file://"))
            try:
                text = path.read_text("utf-8", "replace")
            except OSError as error:
                findings.append(
                    problem(
                        "cyclone",
                        f"CYCLONEDDS_URI in {whose} names {path}, which cannot be read:"
                        f" {error.strerror}",
                        "unset CYCLONEDDS_URI, or name a file that is there",
                    )
                )
                continue
        try:
            roots.append(ElementTree.fromstring(_rooted(text)))
        except ElementTree.ParseError as error:
            findings.append(
                problem(
                    "cyclone",
                    f"CYCLONEDDS_URI in {whose} is no XML that can be read: {error}",
                    "unset CYCLONEDDS_URI, or mend the XML",
                )
            )
    here = {it.name: it.address for it in interfaces()}
    limits = []
    for element in (it for root in roots for it in root.iter()):
        tag = element.tag.rpartition("}")[2].lower()
        if tag == "allowmulticast" and (element.text or "").strip().lower() == "false":
            limits.append("forbids multicast")
        elif tag in ("networkinterface", "networkinterfaceaddress"):
            attributes = {name.lower(): value for name, value in element.attrib.items()}
            wanted = attributes.get("name") or attributes.get("address") or ""
            wanted = wanted or (element.text or "").strip()
            if wanted in ("lo", "127.0.0.1", "::1"):
                limits.append("uses the loopback interface only")
            elif here and not _known(wanted, here):
                findings.append(
                    problem(
                        "cyclone",
                        f"CYCLONEDDS_URI in {whose} asks for the interface {wanted}, which is not"
                        f" up; there are {', '.join(it for it in here if it != 'lo')}",
                        "unset CYCLONEDDS_URI, or name one of these",
                    )
                )
    if limits:
        findings.append(
            note(
                "cyclone",
                f"CYCLONEDDS_URI in {whose} {' and '.join(dict.fromkeys(limits))}: other machines"
                " are reached by listed peers, or not at all",
                "if nodes are missing: unset CYCLONEDDS_URI",
            )
        )
    return findings or [ok("cyclone", f"CYCLONEDDS_URI in {whose} does not narrow discovery")]


def _rooted(text: str) -> str:
    """Cyclone takes fragments; XML wants one root and no declaration within it."""
    stripped = text.strip()
    if stripped.startswith("<?"):
        stripped = stripped.partition("?>")[2]
    return f"<uri>{stripped}</uri>"


def _known(wanted: str, here: Mapping[str, str]) -> bool:
    # An IPv6 address, or an attribute such as autodetermine="true", is not for us to judge.
    return not wanted or ":" in wanted or wanted in here or wanted in here.values()


def check_security(environment: Mapping[str, str], whose: str = SHELL) -> list[Finding]:
    """SROS 2, which uros has not."""
    if environment.get("ROS_SECURITY_ENABLE", "").lower() != "true":
        return []
    return [
        problem(
            "security",
            f"{whose} has ROS_SECURITY_ENABLE=true, and uros has no SROS 2: its agent and tools"
            " join without security, so secured nodes do not see them",
            "unset ROS_SECURITY_ENABLE where the ROS 2 nodes start",
        )
    ]


# --- the interfaces -------------------------------------------------------------------------------


@dataclass(frozen=True)
class Interface:
    name: str
    index: int
    flags: int
    address: str  # the first of IPv4, or empty

    @property
    def is_up(self) -> bool:
        return bool(self.flags & _UP)

    @property
    def is_loopback(self) -> bool:
        return bool(self.flags & _LOOPBACK)

    @property
    def has_multicast(self) -> bool:
        return bool(self.flags & _MULTICAST)

    @property
    def is_inner(self) -> bool:
        return self.name.startswith(_INNER)


def interfaces() -> list[Interface]:
    """Those that are up. Linux only; nothing elsewhere."""
    if sys.platform != "linux":
        return []
    import fcntl

    found = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        for index, name in socket.if_nameindex():
            request = struct.pack("=16s240x", name.encode()[:15])
            try:
                answer = fcntl.ioctl(sock, _SIOCGIFFLAGS, request)
            except OSError:
                continue  # gone meanwhile
            (flags,) = struct.unpack_from("=H", answer, 16)
            try:
                answer = fcntl.ioctl(sock, _SIOCGIFADDR, request)
                address = socket.inet_ntoa(answer[20:24])
            except OSError:
                address = ""
            if flags & _UP:
                found.append(Interface(name, index, flags, address))
    return found


def check_multicast(
    environment: Mapping[str, str], domain: int, found: list[Interface] | None = None
) -> list[Finding]:
    """Whether a datagram to DDS's group, sent on each interface, comes back to this machine.

    It does not leave the machine (its TTL is 0). Nothing is sent where the environment keeps DDS
    from doing so.
    """
    from ...middleware.dds.config import discovery_range

    try:
        if discovery_range(environment) != "SUBNET":
            return []
    except MiddlewareError:
        return []  # which the check of the environment tells
    if sys.platform != "linux":
        return [unknown("multicast", "multicast is tried out on Linux only")]
    all_up = interfaces() if found is None else found
    outer = [it for it in all_up if it.address and not it.is_loopback and not it.is_inner]
    if not outer:
        return [_no_network(all_up)]
    return [_check_interface(it, domain) for it in outer]


def _no_network(all_up: list[Interface]) -> Finding:
    if any(it.is_loopback and it.is_up for it in all_up):
        return note(
            "multicast",
            "no network interface of this machine but loopback is up with an IPv4 address:"
            " nodes meet on this machine only",
            "connect it, or: export ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST",
        )
    return problem("multicast", "not even the loopback interface is up", "sudo ip link set lo up")


def _check_interface(it: Interface, domain: int) -> Finding:
    if not it.has_multicast:
        if it.flags & _POINT_TO_POINT:  # a VPN has none, and is not meant for DDS
            return note(
                "multicast",
                f"{it.name} ({it.address}) has no multicast, as VPNs mostly: nodes behind it are"
                " found by their addresses only",
                "export ROS_STATIC_PEERS='ADDRESS;ADDRESS'",
            )
        return problem(
            "multicast",
            f"{it.name} ({it.address}) is set to no multicast: nodes behind it are not found",
            f"sudo ip link set {it.name} multicast on",
        )
    try:
        came = comes_back(it, spdp_port(domain))
    except OSError as error:
        return problem(
            "multicast",
            f"multicast cannot be used on {it.name} ({it.address}): {error.strerror or error}",
            _send_mend(it, error),
        )
    if came:
        return ok("multicast", f"multicast to {GROUP} works on {it.name} ({it.address})")
    return problem(
        "multicast",
        f"multicast to {GROUP} is lost on {it.name} ({it.address}): a firewall drops it, so that"
        " nodes do not find each other",
        _firewall_mend(it),
    )


def _send_mend(it: Interface, error: OSError) -> str:
    if error.errno == errno.EPERM:
        return _firewall_mend(it)
    if error.errno == errno.ENOBUFS:  # this process has joined one group, and may not
        return "sudo sysctl -w net.ipv4.igmp_max_memberships=20"
    return f"sudo ip route add 224.0.0.0/4 dev {it.name}"


def _firewall_mend(it: Interface) -> str:
    if ufw_is_on():
        subnet = it.address.rpartition(".")[0] + ".0/24"
        return (
            "sudo ufw allow in proto udp to 224.0.0.0/4, and: sudo ufw allow in proto udp from"
            f" {subnet}"
        )
    return (
        "sudo iptables -I INPUT -p udp -d 224.0.0.0/4 -j ACCEPT; where the network itself drops"
        " multicast: export ROS_STATIC_PEERS='ADDRESS;ADDRESS'"
    )


def ufw_is_on(file: Path = _UFW) -> bool:
    try:
        return "ENABLED=yes" in file.read_text("utf-8", "replace").replace('"', "")
    except OSError:
        return False


def check_firewall(on: bool | None = None) -> list[Finding]:
    """A firewall that lets nothing in but what it was told to."""
    if not (ufw_is_on() if on is None else on):
        return []
    return [
        note(
            "firewall",
            "ufw is on: boards and nodes on other machines may not get through to this one",
            "sudo ufw allow 8888 (the agent's port), and: sudo ufw allow in proto udp to"
            " 224.0.0.0/4",
        )
    ]


def comes_back(it: Interface, port: int) -> bool:
    """Whether a datagram to the group on this interface is received by a second socket.

    Raises OSError where it cannot be sent, or the group cannot be joined.
    """
    token = b"uros doctor " + secrets.token_bytes(16)
    request = struct.pack("=4s4si", socket.inet_aton(GROUP), socket.inet_aton(it.address), it.index)
    with _receiver(port) as (receiver, port), _udp() as sender:
        receiver.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, request)
        sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, request)
        sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_LOOP, 1)
        sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 0)
        sender.sendto(token, (GROUP, port))
        end = time.monotonic() + _WAIT
        while (left := end - time.monotonic()) > 0:
            if not select.select([receiver], [], [], left)[0]:
                break
            if receiver.recv(65536) == token:
                return True
        return False


@contextmanager
def _receiver(port: int) -> Iterator[tuple[socket.socket, int]]:
    """A socket on the port of discovery, which participants share; on another where one does not:
    firewalls mind the group more than the port.
    """
    with _udp() as sock:
        try:
            sock.bind((GROUP, port))
        except OSError:
            sock.bind((GROUP, 0))
        yield sock, sock.getsockname()[1]


def _udp() -> socket.socket:
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    return sock
