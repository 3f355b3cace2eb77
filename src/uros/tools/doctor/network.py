"""Checks discovery: the environment, and multicast on the network interfaces."""

from __future__ import annotations

import errno
import os
import select
import socket
import struct
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from ...addresses import POINT_TO_POINT, Interface, interfaces
from ...middleware.base import MiddlewareError
from .finding import Finding, note, ok, problem, unknown

GROUP: Final = "239.255.0.1"  # the multicast group of DDS discovery
_WAIT: Final = 0.5
_UFW: Final = Path("/etc/ufw/ufw.conf")
# Interfaces of containers and virtual machines, which reach no board.
_INNER: Final = ("docker", "veth", "br-", "virbr", "lxc", "cni", "flannel", "cali")


SHELL: Final = "this shell"


def spdp_port(domain: int) -> int:
    """Return the UDP port of multicast discovery in a domain."""
    return 7400 + 250 * domain


# --- the environment ----------------------------------------------------------------------------


def check_range(environment: Mapping[str, str], whose: str = SHELL) -> list[Finding]:
    """Check how far discovery reaches.

    Args:
        environment: The variables.
        whose: Whose environment this is: this shell's, or an agent's.
    """
    from ...middleware.environment import discovery_range

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
        besides = f", except the peers {peers}" if peers else ""
        return [
            note(
                "discovery",
                f"{whose} has {setting}: nodes on other machines are not seen{besides}",
                f"if you have nodes there: unset {name}{again}",
            )
        ]
    if reach == "SYSTEM_DEFAULT":
        return [note("discovery", f"{whose} leaves discovery to the DDS configuration ({setting})")]
    return [ok("discovery", f"{whose} looks for nodes on the whole subnet")]


def check_engine() -> list[Finding]:
    """Tell what joins the network where Cyclone cannot be used."""
    from ...middleware import cyclone_package

    why = cyclone_package.why_missing()
    if not why:
        return []
    what = f"{why}: the agent and the tools use rtps for topics and services"
    if why == cyclone_package.NOT_INSTALLED:
        return [ok("engine", what)]
    action = "install --force-reinstall" if cyclone_package.has_wheel() else "uninstall"
    return [note("engine", what, f"python -m pip {action} cyclonedds")]


def check_cyclone(environment: Mapping[str, str], whose: str = SHELL) -> list[Finding]:
    """Check how CYCLONEDDS_URI limits discovery, if it is set."""
    from ...middleware import cyclonedds_uri

    uri = environment.get("CYCLONEDDS_URI", "")
    if not uri.strip():
        return []
    findings = []
    roots = []
    for part in cyclonedds_uri.parts(uri):
        try:
            roots.append(cyclonedds_uri.parse(cyclonedds_uri.text_of(part)))
        except OSError as error:
            findings.append(
                problem(
                    "cyclone",
                    f"CYCLONEDDS_URI in {whose} names {part}, which cannot be read:"
                    f" {error.strerror}",
                    "unset CYCLONEDDS_URI, or name a file that is there",
                )
            )
        except ValueError as error:
            findings.append(
                problem(
                    "cyclone",
                    f"CYCLONEDDS_URI in {whose} is not sound XML: {error}",
                    "unset CYCLONEDDS_URI, or correct the XML",
                )
            )
    here = {one.name: one.address for one in interfaces()}
    limits = []
    for element in (element for root in roots for element in root.iter()):
        tag = cyclonedds_uri.local_name(element.tag)
        if tag == "allowmulticast" and (element.text or "").strip().lower() == "false":
            limits.append("forbids multicast")
        elif tag in ("networkinterface", "networkinterfaceaddress"):
            attributes = {
                cyclonedds_uri.local_name(name): value for name, value in element.attrib.items()
            }
            wanted = attributes.get("name") or attributes.get("address") or ""
            wanted = wanted or (element.text or "").strip()
            if wanted in ("lo", "127.0.0.1", "::1"):
                limits.append("uses the loopback interface only")
            elif here and not _known(wanted, here):
                findings.append(
                    problem(
                        "cyclone",
                        f"CYCLONEDDS_URI in {whose} asks for the interface {wanted}, which is not"
                        f" up; there are {', '.join(one for one in here if one != 'lo')}",
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
    return findings or [ok("cyclone", f"CYCLONEDDS_URI in {whose} does not limit discovery")]


def _known(wanted: str, here: Mapping[str, str]) -> bool:
    # IPv6 addresses, and attributes such as autodetermine="true", are not checked.
    return not wanted or ":" in wanted or wanted in here or wanted in here.values()


def check_security(environment: Mapping[str, str], whose: str = SHELL) -> list[Finding]:
    """Check whether SROS 2 is on, which uros does not support."""
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


def check_multicast(
    environment: Mapping[str, str], domain: int, found: list[Interface] | None = None
) -> list[Finding]:
    """Check on each interface whether a datagram to DDS's multicast group comes back.

    It does not leave the machine (its TTL is 0). Nothing is sent if the environment restricts
    discovery to less than the subnet.
    """
    from ...middleware.environment import discovery_range

    try:
        if discovery_range(environment) != "SUBNET":
            return []
    except MiddlewareError:
        return []  # check_range reports it
    if sys.platform != "linux":
        return [unknown("multicast", "multicast is checked on Linux only")]
    all_up = interfaces() if found is None else found
    outer = [
        one
        for one in all_up
        if one.address and not one.is_loopback and not one.name.startswith(_INNER)
    ]
    if not outer:
        return [no_network(all_up)]
    return [check_interface(one, GROUP, spdp_port(domain)) for one in outer]


def no_network(all_up: list[Interface]) -> Finding:
    """Return what to say where no interface but loopback has an address."""
    if any(one.is_loopback for one in all_up):
        return note(
            "multicast",
            "no network interface of this machine but loopback is up with an IPv4 address:"
            " nodes communicate on this machine only",
            "connect this machine, or: export ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST",
        )
    return problem("multicast", "not even the loopback interface is up", "sudo ip link set lo up")


def check_interface(interface: Interface, group: str, port: int) -> Finding:
    """Check whether a datagram to a multicast group comes back on an interface.

    Args:
        interface: The interface.
        group: The address of the group.
        port: The UDP port.
    """
    if not interface.has_multicast:
        if interface.flags & POINT_TO_POINT:  # typical of a VPN, and no fault
            return note(
                "multicast",
                f"{interface.name} ({interface.address}) has no multicast, like most VPNs: nodes"
                " behind it are found by their addresses only",
                "export ROS_STATIC_PEERS='ADDRESS;ADDRESS'",
            )
        return problem(
            "multicast",
            f"{interface.name} ({interface.address}) has multicast switched off: nodes behind it"
            " are not found",
            f"sudo ip link set {interface.name} multicast on",
        )
    try:
        came = comes_back(interface, port, group)
    except OSError as error:
        return problem(
            "multicast",
            f"multicast cannot be used on {interface.name} ({interface.address}):"
            f" {error.strerror or error}",
            _send_fix(interface, error),
        )
    if came:
        where = f"{interface.name} ({interface.address})"
        return ok("multicast", f"multicast to {group} works on {where}")
    return problem(
        "multicast",
        f"multicast to {group} is lost on {interface.name} ({interface.address}): a firewall drops"
        " it, so nodes do not find each other",
        _firewall_fix(interface),
    )


def _send_fix(interface: Interface, error: OSError) -> str:
    if error.errno == errno.EPERM:
        return _firewall_fix(interface)
    if error.errno == errno.ENOBUFS:  # this process may not join one more group
        return "sudo sysctl -w net.ipv4.igmp_max_memberships=20"
    return f"sudo ip route add 224.0.0.0/4 dev {interface.name}"


def _firewall_fix(interface: Interface) -> str:
    if ufw_is_on():
        subnet = interface.address.rpartition(".")[0] + ".0/24"
        return (
            "sudo ufw allow in proto udp to 224.0.0.0/4, and: sudo ufw allow in proto udp from"
            f" {subnet}"
        )
    return (
        "sudo iptables -I INPUT -p udp -d 224.0.0.0/4 -j ACCEPT; where the network itself drops"
        " multicast: export ROS_STATIC_PEERS='ADDRESS;ADDRESS'"
    )


def ufw_is_on(file: Path = _UFW) -> bool:
    """Return whether the firewall ufw is enabled."""
    try:
        return "ENABLED=yes" in file.read_text("utf-8", "replace").replace('"', "")
    except OSError:
        return False


def check_firewall(on: bool | None = None) -> list[Finding]:
    """Check whether a firewall is on that blocks incoming datagrams by default."""
    if not (ufw_is_on() if on is None else on):
        return []
    return [
        note(
            "firewall",
            "ufw is on: it may block boards and nodes on other machines",
            "sudo ufw allow 8888 (the agent's port), and: sudo ufw allow in proto udp to"
            " 224.0.0.0/4",
        )
    ]


def comes_back(interface: Interface, port: int, group: str = GROUP) -> bool:
    """Return whether a second socket receives a datagram to the group on this interface.

    Raises:
        OSError: The datagram cannot be sent, or the group cannot be joined.
    """
    token = b"uros doctor " + os.urandom(16)
    address = socket.inet_aton(interface.address)
    request = struct.pack("=4s4si", socket.inet_aton(group), address, interface.index)
    with _receiver(group, port) as (receiver, port), _udp() as sender:
        receiver.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, request)
        sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, request)
        sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_LOOP, 1)
        sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 0)
        sender.sendto(token, (group, port))
        end = time.monotonic() + _WAIT
        while (left := end - time.monotonic()) > 0:
            if not select.select([receiver], [], [], left)[0]:
                break
            if receiver.recv(65536) == token:
                return True
        return False


@contextmanager
def _receiver(group: str, port: int) -> Iterator[tuple[socket.socket, int]]:
    """Open a socket on the discovery port, or on a free port if a participant does not share it.

    Firewalls filter by the group rather than by the port.
    """
    with _udp() as sock:
        try:
            sock.bind((group, port))
        except OSError:
            sock.bind((group, 0))
        yield sock, sock.getsockname()[1]


def _udp() -> socket.socket:
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    return sock
