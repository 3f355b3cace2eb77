"""Clients that bad input must not affect, and checks of the log."""

import socket

from support.client import XrceClient
from support.waiting import eventually

from uros.wire import ids

TYPE = "std_msgs::msg::dds_::UInt8MultiArray_"


class Bystanders:
    """A publisher and a subscriber on lines of their own."""

    def __init__(self, agent, first=100):
        self.agent = agent
        self.publisher, self.subscriber = (
            XrceClient(agent.line(first + i), 0x55550000 + first + i) for i in (0, 1)
        )
        assert self.publisher.open() == self.subscriber.open() == ids.STATUS_OK
        self.writer = self.publisher.writer("publisher", f"rt/bystanders{first}", TYPE)
        self.reader = self.subscriber.reader("subscriber", f"rt/bystanders{first}", TYPE)
        self.subscriber.read(self.reader)
        self.count = 0

    def check(self):
        """Test that the next sample arrives, and that both clients get answers."""
        self.count += 1
        sample = self.count.to_bytes(4, "big") * 8
        self.publisher.write(self.writer, sample)
        assert self.subscriber.sample(self.reader) == sample
        assert not self.subscriber.samples[self.reader]
        assert self.publisher.ping() == self.subscriber.ping() == 1


def wait_for(read_log, text, count=1):
    """Wait until the log contains ``text`` so many times."""
    eventually(lambda: read_log().count(text) >= count, lambda: f"no {text!r} in:\n{read_log()}")


def check_a_client_that_does_not_read_is_disconnected(agent, bystanders):
    """Test on a stream transport that its session is closed and logged, and that others go on."""
    line = agent.line()
    line._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    slow = XrceClient(line, 0x79, mtu=60_000)
    assert slow.open() == 0
    reader = slow.reader("slow", "rt/slow", TYPE, depth=1)
    slow.read(reader, stream=ids.STREAM_BEST_EFFORT)
    writer = bystanders.publisher.writer("publisher", "rt/slow", TYPE)
    for _ in range(400):
        bystanders.publisher.write(writer, bytes(50_000))
        if "does not read its messages" in agent.said.getvalue():
            break
    assert "does not read its messages" in agent.said.getvalue()
    wait_for(agent.said.getvalue, "session closed                 | client_key: 0x00000079")
    assert 0x79 not in agent.agent.clients
    bystanders.check()
