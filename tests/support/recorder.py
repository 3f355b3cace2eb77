"""A session without a connection. Runs on CPython and on MicroPython."""

from support.board import KEY
from uros.client.session import Session


class Recorder(Session):
    """A session alone: ``sent`` has its messages, ``events`` its callbacks as (name, values …)."""

    def __init__(self, key=KEY, mtu=512, limit=32768):
        self.mtu = mtu
        super().__init__(self, key, limit)
        self.make_ready(True)
        self.sent = []
        self.events = []

    def send(self, buf, size):
        self.sent.append(bytes(memoryview(buf)[:size]))

    def on_agent(self, status):
        self.events.append(("agent", status))

    def on_pong(self):
        self.events.append(("pong",))

    def on_unknown(self):
        self.events.append(("unknown",))

    def on_status(self, request_id, status):
        self.events.append(("status", request_id, status))

    def on_time(self, transmit, receive):
        self.events.append(("time", transmit, receive))

    def on_data(self, object_id, buf, start, stop, little):
        self.events.append(("data", object_id, bytes(buf[start:stop]), little))

    def samples(self):
        return [event[2] for event in self.events if event[0] == "data"]
