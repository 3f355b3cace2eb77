"""``uros multicast``: over loopback, on which groups are joined and sent to."""

import socket
import threading

import pytest

from uros import addresses
from uros.tools import cli
from uros.tools.doctor import network as doctor_network
from uros.tools.multicast import group, receive, send


@pytest.fixture
def port():
    """A free port."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("", 0))
        return sock.getsockname()[1]


def test_what_is_sent_is_received(monkeypatch, capsys, port):
    """Both ends on this machine; the datagram goes the way of the kernel's choice."""
    sock = group.receiver(group.GROUP, port)
    joined = []
    monkeypatch.setattr(receive, "receiver", lambda *way: joined.append(way) or sock)
    sending = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sending.sendto(group.TEXT, ("127.0.0.1", port))  # also where there is no route for groups
    options = ["--group", "239.1.2.3", "--port", str(port)]
    assert cli.main(["multicast", "receive", *options]) == 0
    assert joined == [("239.1.2.3", port)]
    out = capsys.readouterr().out.splitlines()
    assert out[0] == "Waiting for UDP multicast datagram..."
    assert out[1] == f"Received from 127.0.0.1:{sending.getsockname()[1]}: 'Hello World!'"
    sending.close()


def test_the_group_the_port_and_the_ttl_are_used(monkeypatch, capsys):
    sent = []
    monkeypatch.setattr(send, "send", lambda *way: sent.append(way))
    assert cli.main("multicast send --group 239.1.2.3 --port 5 --ttl 4".split()) == 0
    assert cli.main(["multicast", "send"]) == 0
    assert sent == [("239.1.2.3", 5, 4), ("225.0.0.1", 49150, None)]
    assert capsys.readouterr().out == "Sending one UDP multicast datagram...\n" * 2


@pytest.mark.parametrize(
    "option, value, said",
    [
        ("--group", "192.168.1.1", "'192.168.1.1' is not a multicast group: those are 224.0.0.0"),
        ("--group", "x", "'x' is not a multicast group"),
        ("--port", "0", "'0' is not a port"),
        ("--port", "65536", "'65536' is not a port"),
        ("--ttl", "256", "'256' is not a TTL"),
    ],
)
def test_wrong_values(capsys, option, value, said):
    assert cli.main(["multicast", "send", option, value]) == 2
    assert said in capsys.readouterr().err


def test_a_network_that_cannot_be_reached(monkeypatch, capsys):
    class Broken(socket.socket):
        def sendto(self, *_):
            raise OSError(101, "Network is unreachable")

        def setsockopt(self, *_):
            raise OSError(19, "No such device")

    monkeypatch.setattr(group.socket, "socket", Broken)
    assert cli.main(["multicast", "send"]) == 1
    assert "225.0.0.1: Network is unreachable; 'uros multicast test'" in capsys.readouterr().err
    assert cli.main(["multicast", "receive"]) == 1
    assert "the group 225.0.0.1 cannot be joined: No such device" in capsys.readouterr().err


def test_a_port_that_is_taken(capsys, port):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("", port))  # and does not share it
        assert cli.main(["multicast", "receive", "--port", str(port)]) == 1
    assert f"port {port} cannot be used: Address already in use; choose another" in (
        capsys.readouterr().err
    )


def test_receive_ends_by_ctrl_c(monkeypatch, port):
    def interrupted(sock):
        raise KeyboardInterrupt

    monkeypatch.setattr(receive, "receive", interrupted)
    assert cli.main(["multicast", "receive", "--port", str(port)]) == 0


def test_each_interface_is_tested(monkeypatch, capsys):
    flags = addresses.UP | addresses.MULTICAST
    up = [
        addresses.Interface("lo", 1, addresses.UP | addresses.LOOPBACK, "127.0.0.1"),
        addresses.Interface("eth0", 2, flags, "192.168.1.2"),
        addresses.Interface("eth1", 3, addresses.UP, "192.168.2.2"),
        addresses.Interface("wlan0", 4, flags, "192.168.3.2"),
    ]
    monkeypatch.setattr(addresses, "interfaces", lambda: up)
    asked = []

    def comes_back(interface, port, group):
        asked.append((interface.name, port, group))
        return interface.name == "eth0"

    monkeypatch.setattr(doctor_network, "comes_back", comes_back)
    assert cli.main("multicast test --group 239.9.9.9 --port 7".split()) == 1
    out = capsys.readouterr().out
    assert "multicast to 239.9.9.9 works on eth0 (192.168.1.2)" in out
    assert "sudo ip link set eth1 multicast on" in out
    assert "multicast to 239.9.9.9 is lost on wlan0" in out and "iptables" in out
    assert asked == [(name, 7, "239.9.9.9") for name in ("eth0", "wlan0")]
    del up[2:]
    assert cli.main(["multicast", "test"]) == 0


def test_a_group_is_joined_on_this_machine(port):
    """With the kernel's own multicast on loopback."""
    lo = next(one for one in addresses.interfaces() if one.is_loopback)
    came = []
    working = threading.Thread(
        target=lambda: came.append(doctor_network.comes_back(lo, port, "239.255.7.7"))
    )
    working.start()
    working.join(60)
    assert came == [True]
