"""Clock, lines and dialogues for tests of modems. Runs on CPython and on MicroPython."""

from uros.transport import at_modem as modem
from uros.transport import esp8266, gs2200

NETWORK, PASSWORD, AGENT = "robots", "secret99", "192.168.1.10"


class FakeTime:
    """Replaces the clock of the transports in a context: time passes only where they wait."""

    def __init__(self, start=1000):
        self.now = start
        self.us = 0

    def ticks_ms(self):
        return self.now & 0x3FFFFFFF

    def ticks_us(self):
        self.us += 20  # reading the clock takes time
        return (self.now * 1000 + self.us) & 0x3FFFFFFF

    def sleep_ms(self, ms):
        self.now += ms

    def __enter__(self):
        self._originals = []
        for module in (modem, esp8266, gs2200):
            for name in ("ticks_ms", "ticks_us", "sleep_ms"):
                if hasattr(module, name):
                    self._originals.append((module, name, getattr(module, name)))
                    setattr(module, name, getattr(self, name))
        return self

    def __exit__(self, *_):
        for module, name, original in self._originals:
            setattr(module, name, original)


class Line:
    """A UART between a transport and a modem.

    A read returns at most ``chunk`` octets, a write takes at most ``takes``. ``damage(octets)``
    alters the modem's output.
    """

    def __init__(self, modem, chunk=1000, takes=1000, damage=bytes):
        self.modem = modem
        self.chunk = chunk
        self.takes = takes
        self.damage = damage
        self.written = b""

    def read(self, size):
        data = self.modem.read(min(size, self.chunk))
        return self.damage(data) if data else None

    def write(self, data):
        data = bytes(data[: self.takes])
        self.written += data
        return self.modem.write(data)


class Setup:
    """A modem in range of an access point, and its transport: ``air``, ``modem``, ``transport``.

    ``link`` is the modem's latest link.
    """

    @property
    def link(self):
        return self.network.links[-1]


def os_error(call, *arguments):
    """The text of the OSError that ``call`` must raise."""
    try:
        result = call(*arguments)
    except OSError as error:
        return str(error)
    raise AssertionError(f"no error: {result!r}")


def until(transport, done, turns=100000):
    """Continue the dialogue until ``done()``; the messages received meanwhile."""
    messages = []
    while not done():
        turns -= 1
        assert turns, "it takes too long"
        message = transport.receive(1)
        if message is not None:
            messages.append(message)
    return messages


def link_up(transport):
    transport.open()
    return until(transport, lambda: transport.linked)


def failure(transport, turns=100000):
    """The text of the OSError that ends the dialogue."""
    while True:
        turns -= 1
        assert turns, "it takes too long"
        try:
            transport.receive(10)
        except OSError as error:
            return str(error)


def drain(transport):
    """Receive all messages that are there."""
    messages = []
    while True:
        message = transport.receive(200)
        if message is None:
            return messages
        messages.append(message)


def exchange(place, messages):
    """Send each message, and the network sends it back; the messages received."""
    received = []
    for message in messages:
        place.transport.send(message)
        place.link.incoming.append(message)
        received += until(
            place.transport, lambda message=message: place.link.sent[-1:] == [message]
        )
    return received + drain(place.transport)


def one_by_one(place, messages):
    """Exchange the messages one at a time; none is lost and no fault is counted."""
    transport, link = place.transport, place.link
    for message in messages:
        transport.send(memoryview(message))
        until(transport, lambda message=message: link.sent[-1:] == [message])
        link.incoming.append(message)
        received = drain(transport)
        assert received == [message], (message, received)
    assert link.sent == list(messages), link.sent
    faults = (transport.dropped, transport.malformed, transport.mute)
    assert faults == (0, 0, 0), faults


def in_order(place, messages, sent):
    """All messages arrive in order, and then the first ``sent`` of them are sent in order."""
    link_up(place.transport)
    place.link.incoming.extend(messages)
    received = drain(place.transport)
    assert received == messages, received
    for message in messages[:sent]:
        place.transport.send(message)
    received = drain(place.transport)
    assert received == [], received
    assert place.link.sent == messages[:sent], place.link.sent


def opened(place, time, turn_ms):
    """Open without waiting and receive until the link is up; (milliseconds, turns).

    A turn, which may wait 20 ms, takes at most ``turn_ms``.
    """
    before = time.now
    place.transport.open()
    assert time.now == before, time.now - before
    turns = 0
    while not place.transport.linked:
        began = time.now
        message = place.transport.receive(20)
        assert message is None, message
        assert time.now - began <= turn_ms, time.now - began
        turns += 1
    return time.now - before, turns


def attempts(place, moment):
    """Open until an exchange succeeds; the number of failures. ``moment`` is for the error."""
    place.transport.open()
    for failed in range(20):
        try:
            until(place.transport, lambda: place.transport.linked)
            exchange(place, [b"hello"])
            return failed
        except OSError:
            place.transport.close()
            place.transport.open()
    raise AssertionError(f"it does not come up: {moment}")


def drops_messages_that_are_too_long(place, long):
    """Messages over 64 octets are dropped and counted; ``long`` has a start of a message inside."""
    link_up(place.transport)
    place.link.incoming.extend([bytes(65), b"fits", long, bytes(64)])
    received = drain(place.transport)
    assert received == [b"fits", bytes(64)], received
    assert place.transport.malformed == 2, place.transport.malformed
    place.transport.send(bytes(65))
    received = drain(place.transport)
    assert place.transport.dropped == 1 and received == [], (place.transport.dropped, received)
    assert place.link.sent == [], place.link.sent
