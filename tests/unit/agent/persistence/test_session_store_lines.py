"""Sessions on serial and CAN lines that survive a restart of the agent."""

import os
import struct
import time
import tty

import pytest
from support import can, stubborn
from support.agent import RunningAgent
from support.lines import SerialLine
from support.stubborn import StubbornClient
from unit.agent import helpers

from uros.agent.persistence.journal import open_journal
from uros.agent.persistence.session_store import SessionStore
from uros.agent.transports.can import CanServer
from uros.agent.transports.serial import SerialServer


class Serial:
    """A serial cable that stays plugged in while agents start and end."""

    def __init__(self):
        self.master, self.slave = os.openpty()
        tty.setraw(self.slave)

    def server(self):
        return SerialServer(os.ttyname(self.slave))

    def line(self):
        return SerialLine(self.master, owned=False)

    def close(self):
        os.close(self.master)
        os.close(self.slave)


class Can:
    def __init__(self):
        self.first = can.virtual()

    def server(self):
        return CanServer(self.first._device, "virtual")

    def line(self):
        return can.VirtualLine(self.first._device, 0x107)

    def close(self):
        pass


class LineClient(StubbornClient):
    def __init__(self, line, key):
        self.line = line
        super().__init__(None, key)

    def _connect(self, port):
        pass

    def _send(self, message):
        self.line.send(message)

    def _receive(self, seconds):
        return self.line.receive(time.monotonic() + seconds)

    def close(self):
        self.line.close()


def start(cable, path):
    running = RunningAgent(cable.server(), "memory", 0, 4)
    running.server.attachments.append(SessionStore(open_journal(path), running.agent.log))
    running.start()
    return running


def talk(client, numbers):
    """Test that the client reads back what it writes, once and in order."""
    before = len(client.samples)
    for number in numbers:
        client.write(0x15, struct.pack("<I", number))
    client.until(
        lambda: not client._out and len(client.samples) == before + len(numbers), "it stands still"
    )
    assert [struct.unpack_from("<I", sample)[0] for sample in client.samples[before:]] == list(
        numbers
    )


@pytest.mark.parametrize("how", ["stopped", "killed"])
@pytest.mark.parametrize("cable", [Serial, Can])
def test_a_client_on_a_line_goes_on(tmp_path, monkeypatch, cable, how):
    path = tmp_path / "state"
    monkeypatch.setattr(stubborn, "FRAGMENT_ROOM", 48)  # for a CAN frame
    cable = cable()
    running = start(cable, str(path))
    client = None
    try:
        client = LineClient(cable.line(), 0xE1)
        client.topic("rt/echo", helpers.INT32)
        client.writer()
        client.reader()
        talk(client, range(3))
        content = path.read_bytes()  # as SIGKILL would leave it
        running.stop()
        if how == "killed":
            path.write_bytes(content)
        running.close()
        running = start(cable, str(path))
        talk(client, range(3, 12))
        log = running.said.getvalue()
        assert log.count("session restored") == 1 and "warning" not in log
    finally:
        running.close()
        if client is not None:
            client.close()
        cable.close()
