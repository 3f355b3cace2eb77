"""`uros doctor`: discovery that the environment narrows, and multicast that a network lacks.

Networks are planted in namespaces of their own: nothing leaves them.
"""

import json
import shlex
import subprocess
import sys

import pytest

from uros.addresses import Interface, interfaces
from uros.middleware import cyclone_package
from uros.tools.doctor.finding import NOTE, OK
from uros.tools.doctor.network import (
    check_cyclone,
    check_firewall,
    check_multicast,
    check_range,
    check_security,
    spdp_port,
    ufw_is_on,
)

# A network of one Ethernet with a cable that ends nowhere else, and the doctor on it.
PLANT = """
set -e
ip link set lo up
ip link add net0 type veth peer name net1
ip addr add 10.9.9.1/24 dev net0
ip link set net1 up
ip link set net0 up
"""
LOOK = """
import json
from uros.tools.doctor.network import check_multicast
print(json.dumps([finding.plain() for finding in check_multicast({}, 7)]))
"""


def in_a_network(fault="", fix=""):
    """What the doctor finds in a planted network, and once more after ``fix``."""
    look = f"{shlex.quote(sys.executable)} -c {shlex.quote(LOOK)}"
    script = "\n".join([PLANT, fault, look, fix, look])
    done = subprocess.run(
        ["unshare", "--net", "--map-root-user", "sh", "-c", script],
        capture_output=True, text=True, timeout=30,
    )  # fmt: skip
    if "unshare failed" in done.stderr or "write failed" in done.stderr:
        pytest.skip("not on this platform: no network namespaces for us")
    assert done.returncode == 0, done.stderr
    return [json.loads(line) for line in done.stdout.splitlines() if line.startswith("[")]


def test_a_healthy_network():
    (one,), _ = in_a_network()
    assert one["state"] == "ok" and "works on net0 (10.9.9.1)" in one["what"]


@pytest.mark.parametrize(
    "fault, words, fix",
    [
        ("ip link set net0 multicast off", "net0 (10.9.9.1) has multicast switched off",
         "ip link set net0 multicast on"),
        ("echo 0 > /proc/sys/net/ipv4/igmp_max_memberships", "cannot be used on net0",
         "sysctl -w net.ipv4.igmp_max_memberships=20"),
    ],
)  # fmt: skip
def test_a_network_without_multicast(fault, words, fix):
    (before,), (after,) = in_a_network(fault, fix)
    assert before["state"] == "problem" and words in before["what"]
    assert before["fix"] == "sudo " + fix
    assert after["state"] == "ok"


def test_a_machine_without_a_network():
    (one,), _ = in_a_network("ip link del net0")
    assert one["state"] == "note" and "no network interface" in one["what"]
    (one,), (after,) = in_a_network("ip link del net0; ip link set lo down", "ip link set lo up")
    assert one["state"] == "problem" and one["fix"] == "sudo ip link set lo up"
    assert after["state"] == "note"


@pytest.mark.parametrize(
    ("why", "has_wheel", "state", "fix"),
    [
        ("", True, None, ""),
        (cyclone_package.NOT_INSTALLED, False, OK, ""),
        ("cyclonedds cannot be loaded (x)", True, NOTE, "install --force-reinstall cyclonedds"),
        ("cyclonedds cannot be loaded (x)", False, NOTE, "uninstall cyclonedds"),
    ],
)
def test_what_is_used_without_cyclone(monkeypatch, why, has_wheel, state, fix):
    from uros.tools.doctor import network

    monkeypatch.setattr(cyclone_package, "why_missing", lambda: why)
    monkeypatch.setattr(cyclone_package, "has_wheel", lambda: has_wheel)
    findings = network.check_engine()
    assert [one.state for one in findings] == ([state] if state else [])
    assert all(why in one.what and "use rtps" in one.what for one in findings)
    assert all(fix in one.fix and bool(fix) == bool(one.fix) for one in findings)


ETHERNET = Interface("eth7", 9, 0x1043, "10.1.2.3")


def test_multicast_that_is_dropped(monkeypatch):
    from uros.tools.doctor import network

    monkeypatch.setattr(network, "comes_back", lambda interface, port, group: False)
    monkeypatch.setattr(network, "ufw_is_on", lambda: False)
    (one,) = check_multicast({}, 0, [ETHERNET])
    assert one.state == "problem" and "a firewall drops it" in one.what
    assert "iptables -I INPUT" in one.fix and "ROS_STATIC_PEERS" in one.fix
    monkeypatch.setattr(network, "ufw_is_on", lambda: True)
    (one,) = check_multicast({}, 0, [ETHERNET])
    assert "sudo ufw allow in proto udp to 224.0.0.0/4" in one.fix and "10.1.2.0/24" in one.fix


def test_multicast_that_may_not_be_sent(monkeypatch):
    from uros.tools.doctor import network

    def forbidden(interface, port, group):
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(network, "comes_back", forbidden)
    (one,) = check_multicast({}, 0, [ETHERNET])
    assert one.state == "problem" and "Operation not permitted" in one.what
    assert "iptables" in one.fix or "ufw" in one.fix


def test_interfaces_that_do_not_count(monkeypatch):
    from uros.tools.doctor import network

    monkeypatch.setattr(network, "comes_back", lambda interface, port, group: True)
    docker = Interface("docker0", 3, 0x1043, "172.17.0.1")
    vpn = Interface("wg0", 4, 0x00D1, "10.8.0.2")
    lo = Interface("lo", 1, 0x49, "127.0.0.1")
    one, two = check_multicast({}, 0, [lo, docker, vpn, ETHERNET])
    assert one.state == "note" and "wg0" in one.what and "ROS_STATIC_PEERS" in one.fix
    assert two.state == "ok" and "eth7" in two.what


@pytest.mark.parametrize(
    "environment",
    [
        {"ROS_LOCALHOST_ONLY": "1"},
        {"ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF"},
        {"ROS_AUTOMATIC_DISCOVERY_RANGE": "nonsense"},
    ],
)
def test_nothing_is_sent_if_the_environment_forbids_it(environment, monkeypatch):
    from uros.tools.doctor import network

    def sent(interface, port, group):
        raise AssertionError("it was sent")

    monkeypatch.setattr(network, "comes_back", sent)
    assert check_multicast(environment, 0, [ETHERNET]) == []


def test_ports_and_interfaces():
    assert (spdp_port(0), spdp_port(5)) == (7400, 8650)
    assert any(interface.is_loopback for interface in interfaces())


# --- the environment ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    "environment, state, words, fix",
    [
        ({}, "ok", "the whole subnet", ""),
        ({"ROS_LOCALHOST_ONLY": "0"}, "ok", "the whole subnet", ""),
        ({"ROS_LOCALHOST_ONLY": "1"}, "note", "ROS_LOCALHOST_ONLY=1", "unset ROS_LOCALHOST_ONLY"),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_STATIC_PEERS": "10.0.0.3"}, "note",
         "except the peers 10.0.0.3", "unset ROS_AUTOMATIC_DISCOVERY_RANGE"),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF"}, "problem", "found by nobody",
         "unset ROS_AUTOMATIC_DISCOVERY_RANGE"),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "HERE"}, "problem", "'HERE' does not exist",
         "unset ROS_AUTOMATIC_DISCOVERY_RANGE"),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "system_default"}, "note", "DDS configuration", ""),
    ],
)  # fmt: skip
def test_the_range_of_discovery(environment, state, words, fix):
    (one,) = check_range(environment)
    assert one.state == state and words in one.what and "this shell" in one.what
    assert fix in one.fix
    # What the command leaves is well.
    if one.fix.endswith(tuple(environment)):
        left = {k: v for k, v in environment.items() if k != one.fix.split()[-1]}
        assert check_range(left)[0].state == "ok"


def test_differences_to_the_agents_environment():
    (one,) = check_range({"ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF"}, "the agent 7")
    assert one.what.startswith("the agent 7 has")


@pytest.mark.parametrize(
    "uri, state, words",
    [
        ("<General><AllowMulticast>false</AllowMulticast></General>", "note", "forbids multicast"),
        ('<CycloneDDS><Domain><General><Interfaces><NetworkInterface name="lo"/></Interfaces>'
         "</General></Domain></CycloneDDS>", "note", "loopback interface only"),
        ('<?xml version="1.0"?><CycloneDDS xmlns="https://cdds.io/config"><Domain><General>'
         "<AllowMulticast>False</AllowMulticast></General></Domain></CycloneDDS>", "note",
         "forbids multicast"),
        ('<General><Interfaces><NetworkInterface name="wlan77"/></Interfaces></General>',
         "problem", "wlan77, which is not up"),
        ("<General><NetworkInterfaceAddress>10.77.77.77</NetworkInterfaceAddress></General>",
         "problem", "10.77.77.77, which is not up"),
        ("<General><AllowMulticast>", "problem", "not sound XML"),
        ("file:///no/such/file.xml", "problem", "/no/such/file.xml, which cannot be read"),
        ("<Tracing><Verbosity>warning</Verbosity></Tracing>", "ok", "does not limit"),
    ],
)  # fmt: skip
def test_a_users_own_cyclone(uri, state, words):
    (one,) = check_cyclone({"CYCLONEDDS_URI": uri})
    assert one.state == state and words in one.what
    assert state == "ok" or "unset CYCLONEDDS_URI" in one.fix
    assert check_cyclone({}) == []


def test_a_users_own_cyclone_in_a_file(tmp_path):
    file = tmp_path / "cyclone.xml"
    file.write_text("<CycloneDDS><Domain><General><AllowMulticast>false</AllowMulticast></General>"
                    "</Domain></CycloneDDS>")  # fmt: skip
    for uri in (str(file), f"file://{file}"):
        (one,) = check_cyclone({"CYCLONEDDS_URI": uri})
        assert one.state == "note" and "forbids multicast" in one.what


def test_security():
    assert check_security({}) == check_security({"ROS_SECURITY_ENABLE": "false"}) == []
    (one,) = check_security({"ROS_SECURITY_ENABLE": "true"})
    assert one.state == "problem" and "no SROS 2" in one.what
    assert one.fix.startswith("unset ROS_SECURITY_ENABLE")


def test_the_firewall(tmp_path):
    file = tmp_path / "ufw.conf"
    assert not ufw_is_on(file)
    file.write_text("# comment\nENABLED=no\n")
    assert not ufw_is_on(file)
    file.write_text("# comment\nENABLED=yes\nLOGLEVEL=low\n")
    assert ufw_is_on(file)
    (one,) = check_firewall(True)
    assert one.state == "note" and "sudo ufw allow 8888" in one.fix
    assert check_firewall(False) == []
