"""A node with a scripted agent: calls its services and takes its published messages.

Runs on CPython and on MicroPython. Values are lists, as in uros.client.dynamic_messages.
"""

from support.board import KEY, FakeAgent, FakeClock
from uros.client import AGENT_CONNECTED, WAITING_AGENT, Node
from uros.wire import ids

IDENTITY = bytes(range(24))


class Bench:
    """A ``node``, its ``agent`` and ``clock``, and the ``errors`` that its callbacks raised."""

    def __init__(self, name="node", namespace="", connect=True, make=Node, **options):
        self.clock = FakeClock()
        self.agent = FakeAgent(self.clock, 4096)  # no sample of these tests is split into fragments
        self.node = make(name, self.agent, namespace, 0, KEY, clock=self.clock, **options)
        self.errors = []
        self.node.executor.report = self.errors.append
        if connect:
            self.connect()

    def connect(self):
        """Spin until the node is connected and its entities exist."""
        self.until(lambda: self.node.state == AGENT_CONNECTED)
        self.run(50)

    def until(self, done):
        for _ in range(3000):
            if done():
                return
            self.node.spin_once(0.01)
        raise AssertionError("it does not come")

    def run(self, ms=10):
        end = self.clock.t + ms * 1000
        while self.clock.t < end:
            self.node.spin_once((end - self.clock.t) / 1000000)

    def lose(self):
        """The agent ends, and another one starts."""
        self.agent.silent = True
        self.until(lambda: self.node.state == WAITING_AGENT)
        self.agent.silent = False
        self.agent.forget()

    def entity(self, name):
        """The entity of this full name."""
        (match,) = [entity for entity in self.node._entities if getattr(entity, "name", "") == name]
        return match

    def ask(self, name, values):
        """Call a service with these values; the values of its reply."""
        service = self.entity(name)
        request = service.type.Request(values)
        octets = bytearray(request.cdr_size())
        request.pack_into(octets, 0, 0)
        self.agent.samples.clear()
        thing = service.object_id(ids.KIND_REPLIER)
        self.agent.sample(thing, IDENTITY + bytes(octets))
        self.run(200)
        answers = [sample for sample in self.agent.samples if sample[0] == thing]
        assert len(answers) == 1, answers
        sample = bytes(answers[0][1])
        assert sample[:24] == IDENTITY
        response, _ = service.type.Response.unpack_from(sample, 24, 24, len(sample))
        assert response.cdr_size() == len(sample) - 24
        return response.values

    def heard(self, name):
        """The values of all messages that the topic's publisher sent since the last call."""
        publisher = self.entity(name)
        self.run(50)
        thing = publisher.object_id(ids.KIND_DATAWRITER)
        out = []
        for object_id, sample in self.agent.samples:
            if object_id == thing:
                message, _ = publisher.type.unpack_from(bytes(sample), 0, 0, len(sample))
                assert message.cdr_size() == len(sample)
                out.append(message.values)
        self.agent.samples.clear()
        return out


def raised(error, call, *arguments):
    """The text of the error that ``call`` must raise."""
    try:
        call(*arguments)
    except error as caught:
        return str(caught)
    raise AssertionError(f"nothing raised: {arguments!r}")
