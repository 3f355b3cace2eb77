"""A session without a board around it. Runs on CPython and on MicroPython."""

from support.board import KEY
from uros.client.session import Session


class Recorder(Session):
    """A session by itself: ``sent`` is what it sends, ``told`` are (name, values …) in order."""

    def __init__(self, key=KEY, mtu=512, limit=32768):
        self.mtu = mtu
        super().__init__(self, key, limit)
        self.make_ready(True)
        self.sent = []
        self.told = []

    def send(self, buf, size):
        self.sent.append(bytes(memoryview(buf)[:size]))

    def on_agent(self, status):
        self.told.append(("agent", status))

    def on_pong(self):
        self.told.append(("pong",))

    def on_unknown(self):
        self.told.append(("unknown",))

    def on_status(self, request_id, status):
        self.told.append(("status", request_id, status))

    def on_time(self, transmit, receive):
        self.told.append(("time", transmit, receive))

    def on_data(self, object_id, buf, start, stop, little):
        self.told.append(("data", object_id, bytes(buf[start:stop]), little))

    def samples(self):
        return [it[2] for it in self.told if it[0] == "data"]
