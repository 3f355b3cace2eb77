"""Several devices in one agent: each is opened and lost on its own, with its own boards."""

import os
import tty

import pytest
from support.agent import running_agent
from support.client import XrceClient
from support.lines import SerialLine
from unit.agent.transports.faults import TYPE, wait_for

from uros.agent.transports import line as line_module
from uros.agent.transports import multiserial as module
from uros.agent.transports.base import TransportError
from uros.agent.transports.multiserial import devices_in, serial_servers


@pytest.fixture
def agent(monkeypatch):
    monkeypatch.setattr(line_module, "RETRY", 0.01)
    with running_agent("multiserial", "memory") as running:
        yield running


def test_boards_with_the_same_address_and_session_on_two_devices(agent):
    first, second = (XrceClient(agent.line(i), 0x61 + i) for i in (0, 1))
    assert first.open() == second.open() == 0
    assert set(agent.agent.clients) == {0x61, 0x62}
    writers = [client.writer("n", f"rt/t{client.key}", TYPE) for client in (first, second)]
    readers = [client.reader("n", f"rt/t{client.key}", TYPE) for client in (first, second)]
    for client, reader in zip((first, second), readers, strict=True):
        client.read(reader)
    for i in range(20):
        first.write(writers[0], bytes([1, i]))
        second.write(writers[1], bytes([2, i]))
        assert first.sample(readers[0]) == bytes([1, i])
        assert second.sample(readers[1]) == bytes([2, i])
    log = agent.said.getvalue()
    for server in agent.server.transports:
        assert f"address: {server.device} (1)" in log
        assert list(server.sessions) == [1]
    assert first.close() == 0
    assert second.ping() == 1


def test_one_device_is_unplugged_and_the_other_goes_on(tmp_path, monkeypatch):
    monkeypatch.setattr(line_module, "RETRY", 0.01)
    ends, links = [], [tmp_path / "ttyA", tmp_path / "ttyB"]

    def plug(link):
        master, slave = os.openpty()
        tty.setraw(slave)
        link.unlink(missing_ok=True)
        link.symlink_to(os.ttyname(slave))
        ends.extend((master, slave))
        return SerialLine(master, owned=False)

    def unplug(at):
        for fd in ends[2 * at : 2 * at + 2]:
            os.close(fd)
            ends[ends.index(fd)] = -1

    with running_agent("pseudoterminal", "memory") as agent:
        # Replaces its own transport, which never has anything to do.
        servers = serial_servers([str(link) for link in links])
        agent.server.transports.extend(servers)
        for server in servers:
            agent.server.wake_at(0, lambda serial_server=server: serial_server.open(agent.server))
        agent.server._wake.set()
        wait_for(agent.said.getvalue, "waiting for device", 2)
        first = XrceClient(plug(links[0]), 0x71)
        wait_for(agent.said.getvalue, "running...", 2)
        assert first.open() == 0  # while the other device is missing
        second = XrceClient(plug(links[1]), 0x72)
        wait_for(agent.said.getvalue, "running...", 3)
        assert second.open() == 0
        writer, reader = second.writer("n", "rt/b", TYPE), second.reader("n", "rt/b", TYPE)
        second.read(reader)
        for turn in range(3):
            links[1].unlink()
            unplug(1 if not turn else len(ends) // 2 - 1)
            wait_for(agent.said.getvalue, "device lost", turn + 1)
            assert first.ping() == 1
            second.line = plug(links[1])
            second.write(writer, bytes([turn]))
            assert second.sample(reader) == bytes([turn])
        assert servers[0].line.stream is not None
    for fd in ends:
        if fd >= 0:
            os.close(fd)


def test_the_names_of_the_log(agent):
    assert {transport.name for transport in agent.server.transports} == {"MultiSerialAgent"}


def test_invalid_lists_of_devices_are_refused(monkeypatch):
    for devices, why in (
        ([], "name some"),
        (["/dev/a", "/dev/b", "/dev/a"], "/dev/a: named twice"),
    ):
        with pytest.raises(TransportError, match=why):
            serial_servers(devices)
    monkeypatch.setattr(module, "MAX_DEVICES", 2)
    with pytest.raises(TransportError, match="3 devices are over 2: start another agent"):
        serial_servers(["/dev/a", "/dev/b", "/dev/c"])
    with pytest.raises(TransportError, match="baud rate -1"):
        serial_servers(["/dev/a"], -1)


def test_devices_in_a_file(tmp_path, monkeypatch):
    file = tmp_path / "devices"
    file.write_text("/dev/ttyA\n\n  # the other bench\n /dev/ttyB \r\n")
    assert devices_in(str(file)) == ["/dev/ttyA", "/dev/ttyB"]
    file.write_bytes(b"\xff\xfe")
    for content, why in ((b"\xff\xfe", "is not a text file"), (b"# none\n\n", "names no device")):
        file.write_bytes(content)
        with pytest.raises(TransportError, match=why):
            devices_in(str(file))
    monkeypatch.setattr(module, "_MAX_FILE", 10)
    file.write_bytes(b"a\n" * 6)
    with pytest.raises(TransportError, match="over 10 bytes"):
        devices_in(str(file))
    with pytest.raises(TransportError, match="No such file"):
        devices_in(str(tmp_path / "none"))
    with pytest.raises(TransportError, match="a directory"):
        devices_in(str(tmp_path))
