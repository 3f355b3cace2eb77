"""Time and lines for tests of modems. Runs on CPython and on MicroPython."""

from uros.transport import esp8266, gs2200, modem


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
