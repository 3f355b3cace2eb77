"""Time, lines and dialogues for tests of modems. Runs on CPython and on MicroPython."""

from uros.transport import at_modem as modem
from uros.transport import esp8266, gs2200

NETWORK, PASSWORD, AGENT = "robots", "secret99", "192.168.1.10"


class FakeTime:
    """In place of the transports' clock, as a context: time passes only where they wait."""

    def __init__(self, start=1000):
        self.now = start
        self.us = 0

    def ticks_ms(self):
        return self.now & 0x3FFFFFFF

    def ticks_us(self):
        self.us += 20  # a look at the clock takes its time
        return (self.now * 1000 + self.us) & 0x3FFFFFFF

    def sleep_ms(self, ms):
        self.now += ms

    def __enter__(self):
        self._kept = []
        for module in (modem, esp8266, gs2200):
            for name in ("ticks_ms", "ticks_us", "sleep_ms"):
                if hasattr(module, name):
                    self._kept.append((module, name, getattr(module, name)))
                    setattr(module, name, getattr(self, name))
        return self

    def __exit__(self, *_):
        for module, name, was in self._kept:
            setattr(module, name, was)


class Line:
    """A UART between a transport and a modem. ``chunk`` is how much it brings at once, ``takes``
    how much it takes; ``damage(octets)`` is what becomes of what the modem says."""

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
    """A modem in reach of an access point, and a transport on it: ``air``, ``modem`` and
    ``transport``. ``link`` is the modem's last one."""

    @property
    def link(self):
        return self.network.links[-1]


def trouble(call, *arguments):
    """The text of the OSError that call must raise."""
    try:
        result = call(*arguments)
    except OSError as error:
        return str(error)
    raise AssertionError(f"no error: {result!r}")


def until(transport, done, turns=100000):
    """Takes the dialogue on until something is so; what came meanwhile."""
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
    """The error that a dialogue ends with."""
    while True:
        turns -= 1
        assert turns, "it takes too long"
        try:
            transport.receive(10)
        except OSError as error:
            return str(error)


def drain(transport):
    """All that has come."""
    messages = []
    while True:
        message = transport.receive(200)
        if message is None:
            return messages
        messages.append(message)


def exchange(place, messages):
    """Each message there and back; what came back."""
    got = []
    for it in messages:
        place.transport.send(it)
        place.link.incoming.append(it)
        got += until(place.transport, lambda it=it: place.link.sent[-1:] == [it])
    return got + drain(place.transport)


def one_by_one(place, messages):
    """Each message goes there, and only then back; none is lost, and nothing is found wrong."""
    transport, link = place.transport, place.link
    for it in messages:
        transport.send(memoryview(it))
        until(transport, lambda it=it: link.sent[-1:] == [it])
        link.incoming.append(it)
        got = drain(transport)
        assert got == [it], (it, got)
    assert link.sent == list(messages), link.sent
    faults = (transport.dropped, transport.malformed, transport.mute)
    assert faults == (0, 0, 0), faults


def in_order(place, messages, sent):
    """All messages come as they were sent by the network, and then so many go out as they came."""
    link_up(place.transport)
    place.link.incoming.extend(messages)
    got = drain(place.transport)
    assert got == messages, got
    for it in messages[:sent]:
        place.transport.send(it)
    got = drain(place.transport)
    assert got == [], got
    assert place.link.sent == messages[:sent], place.link.sent


def opened(place, time, turn_ms):
    """Opens without waiting. Until the link is there, a turn of 20 ms takes at most so long; how
    long all took, and in how many turns."""
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
    """Opens until a message went both ways; how often that failed. ``moment`` is for the error."""
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


def passes_over_what_is_too_long(place, long):
    """Of 64 octets are the longest messages, ``long`` looks as if something began in it."""
    link_up(place.transport)
    place.link.incoming.extend([bytes(65), b"fits", long, bytes(64)])
    got = drain(place.transport)
    assert got == [b"fits", bytes(64)], got
    assert place.transport.malformed == 2, place.transport.malformed
    place.transport.send(bytes(65))
    got = drain(place.transport)
    assert place.transport.dropped == 1 and got == [], (place.transport.dropped, got)
    assert place.link.sent == [], place.link.sent
