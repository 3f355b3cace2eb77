"""Bluetooth, with TCP in place of the radio: boards that wait, boards that connect, errors."""

import errno
import socket

import pytest
from support.agent import running_agent
from support.bluetooth import Air
from support.client import XrceClient
from support.lines import SECONDS, SerialLine
from unit.agent.transports.bare_host import BareHost
from unit.agent.transports.faults import TYPE, wait_for

from uros.agent.transports import line as line_module
from uros.agent.transports import rfcomm as module
from uros.agent.transports.base import TransportError
from uros.agent.transports.rfcomm import (
    RfcommListener,
    RfcommServer,
    bluetooth_socket,
    check_address,
)

BOARD = "AA:BB:CC:DD:EE:01"


@pytest.fixture
def air():
    return Air()


@pytest.fixture
def host():
    bare_host = BareHost()
    yield bare_host
    bare_host.close()


def test_a_board_that_waits_to_be_connected_to(air, monkeypatch):
    monkeypatch.setattr(line_module, "RETRY", 0.01)
    socks = []
    with running_agent(RfcommServer(BOARD.lower(), 2, air.make), "memory") as agent:
        wait_for(agent.said.getvalue, "waiting for device")
        assert f"device: {BOARD}/2, errno: {errno.EHOSTDOWN}, the board does not answer" in (
            agent.said.getvalue()
        )

        def switch_on():
            listener = air.waiting_board(BOARD, 2)
            listener.settimeout(SECONDS)
            socks.extend((listener, listener.accept()[0]))
            return SerialLine(socks[-1].fileno(), owned=False)

        client = XrceClient(switch_on(), 0x81)
        assert client.open() == 0
        writer, reader = client.writer("n", "rt/a", TYPE), client.reader("n", "rt/a", TYPE)
        client.read(reader)
        for turn in range(1, 4):
            for sock in socks[-2:]:
                sock.close()
            wait_for(agent.said.getvalue, "device lost", turn)
            client.line = switch_on()
            client.write(writer, bytes([turn]) * 20)  # the board goes on in its session
            assert client.sample(reader) == bytes([turn]) * 20
        assert list(agent.agent.clients) == [0x81]
        assert f"address: {BOARD}/2 (1)" in agent.said.getvalue()
    for sock in socks:
        sock.close()


def test_boards_that_connect_and_come_back():
    with running_agent("rfcomm", "memory") as agent:
        first, second = (XrceClient(agent.line(i), 0x91 + i) for i in (0, 1))
        assert first.open() == second.open() == 0
        writer, reader = first.writer("n", "rt/a", TYPE), second.reader("n", "rt/a", TYPE)
        second.read(reader)
        for turn in range(3):
            second.line = agent.line(1)  # its old connection hangs; the new one replaces it
            assert second.ping() == 1
            first.write(writer, bytes([turn]))
            assert second.sample(reader) == bytes([turn])
        assert "address: AA:BB:CC:DD:EE:01 (1)" in agent.said.getvalue()
        assert set(agent.agent.clients) == {0x91, 0x92}


@pytest.mark.parametrize(
    ("call", "number", "remedy"),
    [
        ("make", errno.EAFNOSUPPORT, "modprobe rfcomm"),
        ("connect", errno.EHOSTDOWN, "switch it on"),
        ("connect", errno.EHOSTUNREACH, "bluetoothctl power on"),
        ("connect", errno.ECONNREFUSED, "nothing listens on this channel"),
        ("connect", errno.EACCES, "bluetoothctl pair"),
    ],
)
def test_errors_of_connecting_say_what_to_do_and_are_tried_again(air, host, call, number, remedy):
    air.errors[call] = [number, number]
    board = air.waiting_board(BOARD)
    server = RfcommServer(BOARD, make=air.make)
    server.open(host)
    host.fire()
    host.fire()
    host.until(lambda: server.line.stream is not None)
    assert air.tried == [(call, number)] * 2
    assert host.said().count(f"device: {BOARD}/1, errno: {number}, ") == 1
    assert remedy in host.said()
    server.close()
    board.close()


@pytest.mark.parametrize(
    ("call", "number", "remedy"),
    [
        ("make", errno.EPROTONOSUPPORT, "modprobe rfcomm"),
        ("bind", errno.EADDRNOTAVAIL, "bluetoothctl list"),
        ("bind", errno.EADDRINUSE, "choose another channel"),
    ],
)
def test_errors_of_listening_say_what_to_do_and_are_tried_again(air, host, call, number, remedy):
    air.errors[call] = [number, number]
    server = RfcommListener(4, make=air.make)
    server.open(host)
    host.fire()
    host.fire()
    assert host.said().count(f"channel: 4, errno: {number}, ") == 1
    assert remedy in host.said() and "running..." in host.said()
    with air.board(BOARD, 4):
        host.until(lambda: BOARD in server.lines)
    server.close()


@pytest.mark.parametrize("address", ["", "AA:BB:CC:DD:EE", "AA:BB:CC:DD:EE:FG", "/dev/rfcomm0"])
def test_invalid_addresses_are_refused(address):
    with pytest.raises(TransportError, match="bluetoothctl devices"):
        RfcommServer(address, make=socket.socket)


def test_addresses_as_windows_writes_them():
    assert check_address("aa-bb-cc-dd-ee-ff") == "AA:BB:CC:DD:EE:FF"


@pytest.mark.parametrize("channel", [0, -1, 31])
def test_invalid_channels_are_refused(channel):
    for make in (lambda: RfcommServer(BOARD, channel), lambda: RfcommListener(channel)):
        with pytest.raises(TransportError, match=f"channel {channel} does not exist: 1 to 30"):
            make()


def test_a_python_without_bluetooth(monkeypatch):
    monkeypatch.delattr(module.socket, "AF_BLUETOOTH", raising=False)
    with pytest.raises(TransportError, match="rfcomm bind 0 ADDRESS CHANNEL"):
        RfcommListener()


def test_the_sockets_of_a_python_with_bluetooth(monkeypatch):
    calls = []
    monkeypatch.setattr(module.socket, "AF_BLUETOOTH", 31, raising=False)
    monkeypatch.setattr(module.socket, "BTPROTO_RFCOMM", 3, raising=False)
    make = bluetooth_socket()
    monkeypatch.setattr(module.socket, "socket", lambda *args: calls.append(args))
    make()
    assert calls == [(31, socket.SOCK_STREAM, 3)]
