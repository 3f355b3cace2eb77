"""A board's transport with a modem, an ESP8266 on a UART or a GS2200 on SPI, that sends any bytes
at any time in addition to those of a real one.

The first byte has the modem (bit 0), its dialect (1), how much the line reads and writes at once (2
to 5), and whether the board has a link at the start (6). The records follow; the low three bits of
the operation are the kind:

====  ====================================================================
0     the modem sends these bytes unsolicited
1     the board sends this datagram
2     the board receives for so many milliseconds
3     the board closes its transport; with bit 3 it opens it
4     the board receives repeatedly for so many milliseconds
5     a datagram comes from the agent
6     a fault of the modem begins or ends, or an event occurs
7     on a UART: the next bytes are lost or damaged; on SPI: the bus returns these bytes, and the
      pin is high while there are any
====  ====================================================================

Only OSError may be raised, no call may exceed its time limit, and no buffer its size. When the
modem works again, the board, which opens again after each error, must get its link.
"""

from collections.abc import Iterator
from random import Random

from support.modem import FakeTime

from uros.boards.virtual.modems.esp8266 import Esp8266
from uros.boards.virtual.modems.gs2200 import Gs2200
from uros.boards.virtual.modems.radio_network import RadioNetwork
from uros.transport.at_modem import ModemTransport
from uros.transport.esp8266 import Esp8266Transport
from uros.transport.gs2200 import Gs2200Transport

from . import records
from .world import must

NETWORK, PASSWORD, AGENT = "robots", "secret99", "192.168.1.10"
MTU = 128
OPS = tuple(range(0x40))
SAY, SEND, RECEIVE, OPEN, TIME, COMES, FAULT, LINE = range(8)
_CHUNKS = (1, 3, 17, 1000)
_TAKES = (1000, 1, 0, 40)
# A dialogue with all its time-outs, except for joining, ends within this time.
_MAX_MS = 15_000
_SLEEP_MS = 8  # the shortest sleep: it saves turns
_MAX_LOOKS = 4000  # in one call; more would be endless
_EVENTS = ("reset", "lose_network", "lose_link")
_FAULTS = {
    "esp8266": ("dead", "deaf", "full", "stuck", "no_ip"),
    "gs2200": ("dead", "busy", "late"),
}


class Time(FakeTime):
    def sleep_ms(self, ms: int) -> None:
        self.now += max(ms, _SLEEP_MS)


class Looks:
    """Counts the accesses to the line in one call."""

    def __init__(self) -> None:
        self.count = 0

    def count_access(self) -> None:
        self.count += 1
        must(self.count < _MAX_LOOKS, "a call does not come back")


class Uart:
    """The UART between the transport and the modem; see LINE above."""

    def __init__(self, modem: Esp8266, time: FakeTime, looks: Looks, options: int) -> None:
        self.modem = modem
        self.time = time
        self.looks = looks
        self.chunk = _CHUNKS[options >> 2 & 3]
        self.takes = _TAKES[options >> 4 & 3]
        self.damage = b""

    def read(self, size: int) -> "bytes | None":
        self.looks.count_access()
        data = self.modem.read(min(size, self.chunk))
        if not data or not self.damage:
            return data
        hurt = self.damage[: len(data)].ljust(len(data), b"\0")
        self.damage = self.damage[len(data) :]
        return bytes(a ^ b for a, b in zip(data, hurt, strict=True) if b != 0xFF) or None

    def write(self, data: memoryview) -> "int | None":
        self.looks.count_access()
        taken = bytes(data[: self.takes])
        return self.modem.write(taken) if taken else None

    def wait(self, ms: int) -> None:
        must(ms > 0, "it waits for nothing")
        if not self.modem.any():
            self.time.sleep_ms(min(ms, 10))


class Spi:
    """The SPI bus and the pin between the transport and the modem."""

    def __init__(self, modem: Gs2200, looks: Looks) -> None:
        self.modem = modem
        self.looks = looks
        self.brings = b""

    def value(self, level: "int | None" = None) -> int:
        self.looks.count_access()
        return 1 if self.brings else self.modem.value()

    def write(self, data: bytes) -> None:
        self.looks.count_access()
        self.modem.write(data)

    def readinto(self, into: bytearray, write: int = 0) -> None:
        self.looks.count_access()
        self.modem.readinto(into, write)
        some = self.brings[: len(into)]
        self.brings = self.brings[len(into) :]
        into[: len(some)] = some


class Play:
    def __init__(self, time: FakeTime, options: int) -> None:
        self.time = time
        self.looks = Looks()
        self.network = RadioNetwork({NETWORK: PASSWORD}, (AGENT,))
        self.left_ms = _MAX_MS
        self.is_open = False
        self.line: Uart | Spi
        self.modem: Esp8266 | Gs2200
        self.transport: ModemTransport
        if options & 1:
            self.faults = _FAULTS["gs2200"]
            self.modem = Gs2200(self.network, time.ticks_ms, sender=bool(options & 2))
            self.line = Spi(self.modem, self.looks)
            self.transport = Gs2200Transport(
                self.line, self.line, NETWORK, PASSWORD, AGENT, mtu=MTU, room=300
            )
        else:
            self.faults = _FAULTS["esp8266"]
            self.modem = Esp8266(self.network, time.ticks_ms, "nonos" if options & 2 else "esp-at")
            self.line = Uart(self.modem, time, self.looks, options)
            self.transport = Esp8266Transport(
                self.line, NETWORK, PASSWORD, AGENT, mtu=MTU, room=300
            )

    # --- the board's calls --------------------------------------------------------------------

    def receive(self, ms: int) -> "bytes | None":
        """Receive a message. Raises OSError, after which the transport must be closed."""
        self.looks.count = 0
        began = self.time.now
        try:
            message = self.transport.receive(ms)
        except OSError as error:
            self.failed(error)
            raise
        finally:
            must(self.time.now - began <= ms + 2 * _SLEEP_MS, "it waits longer than it may")
            self.check()
        must(message is None or 0 < len(message) <= MTU, "a message that cannot be")
        return message

    def send(self, message: bytes) -> None:
        self.looks.count = 0
        began = self.time.now
        try:
            self.transport.send(message, len(message))
        except OSError as error:
            self.failed(error)
        must(self.time.now == began, "sending waits")
        self.check()

    def failed(self, error: OSError) -> None:
        text = str(error)
        must("modem" in text, f"an error that does not tell whose: {text}")
        must(len(text) < 300, "an error for people")

    def open(self) -> None:
        self.looks.count = 0
        self.transport.open()
        self.is_open = True

    def close(self) -> None:
        self.looks.count = 0
        self.transport.close()
        self.is_open = False
        must(not self.transport.linked, "closed, and linked")

    def step(self, ms: int) -> None:
        end = self.time.now + min(ms, self.left_ms)
        while self.time.now < end:
            before = self.time.now
            try:
                self.receive(20)
            except OSError:
                self.time.now += 500
                if self.is_open:
                    self.close()
                    self.open()
            self.time.now = max(self.time.now, before + 1)
            self.left_ms -= self.time.now - before

    def check(self) -> None:
        transport = self.transport
        must(len(transport._answers) <= 8, "answers are kept")
        must(
            transport._length <= len(transport._line) == 96 and len(transport._info) <= 96,
            "a line grows",
        )
        must(len(transport._messages) < 200, "messages are kept")
        must(0 <= transport._left <= 9999, "a length that cannot be")
        must(0 <= transport._to <= len(transport._out) == 300, "the queue grows")
        must(len(transport._in) == MTU, "the buffer of what comes grows")

    # --- the records --------------------------------------------------------------------------

    def do(self, op: int, body: bytes) -> None:
        kind = op & 7
        number = int.from_bytes(body[:2], "little")
        if kind == SAY:
            self.modem.emit(body)
        elif kind == SEND:
            self.send(body)
        elif kind == RECEIVE:
            try:
                self.receive(number % 100)
            except OSError:
                pass
        elif kind == OPEN:
            if op & 8:
                self.open()
            else:
                self.close()
        elif kind == TIME:
            self.step(number)
        elif kind == COMES:
            if self.network.links:
                self.network.links[-1].incoming.append(body[:1400] or b"\0")
        elif kind == FAULT:
            fault = op >> 3
            if fault < len(self.faults):
                self.modem.faults ^= {self.faults[fault]}
            elif hasattr(self.modem, _EVENTS[fault % 3]):
                getattr(self.modem, _EVENTS[fault % 3])()
        elif isinstance(self.line, Uart):
            self.line.damage = body
        else:
            self.line.brings = body

    # --- the end ------------------------------------------------------------------------------

    def behaves(self) -> None:
        """Remove all faults of modem and line."""
        self.modem.faults.clear()
        if isinstance(self.line, Uart):
            self.line.damage = b""
            self.line.takes = 1000
        else:
            self.line.brings = b""

    def healed(self) -> None:
        """Open again after each error, as a node does, until messages pass in both directions."""
        self.open()
        for _ in range(8):
            end = self.time.now + 30_000
            next_send = 0
            answered = False
            try:
                while self.time.now < end:
                    links = self.network.links
                    if self.transport.linked and self.time.now >= next_send:
                        next_send = self.time.now + 2000
                        self.send(b"the question")
                        links[-1].incoming.append(b"the answer")
                    answered = self.receive(20) == b"the answer" or answered
                    if answered and links and b"the question" in links[-1].sent:
                        return
                    self.time.now += 1
            except OSError:
                pass
            self.close()
            self.open()
        must(False, "it does not heal")


def one_input(data: bytes) -> None:
    options = data[0] if data else 0
    with Time() as time:
        play = Play(time, options)
        play.open()
        if options & 0x40:
            play.step(3000)
        for op, body in records.unpack(data[1:]):
            play.do(op, body)
        play.behaves()
        play.healed()
        play.close()
        play.close()


_WORDS: dict[int, tuple[bytes, ...]] = {
    0: (
        b"\r\n", b"OK\r\n", b"ERROR\r\n", b"FAIL\r\n", b"SEND OK\r\n", b"SEND FAIL\r\n", b"> ",
        b"+IPD,5:hello", b"+IPD,", b":", b"ready\r\n", b"CLOSED\r\n", b"WIFI DISCONNECT\r\n",
        b"busy p...\r\n", b"busy s...\r\n", b"+CWJAP:2\r\n", b"no ip\r\n", b"+IPD,8193:",
        b'+CWJAP:"robots","02:00:00:00:00:01",6,-51\r\n', b"WIFI GOT IP\r\n", b"+IPD,0,9:",
    ),
    1: (
        b"\r\n", b"OK\r\n", b"ERROR\r\n", b"ERROR: INVALID INPUT\r\n", b"\x1b", b"\x1bF", b"\x1bO",
        b"\x1bZ00005hello", b"\x1by0192.168.1.10 8888\t0005hello", b"\x1bZ09999", b"\x1bH0",
        b"CONNECT 0\r\n", b"CONNECT 1\r\n", b"DISCONNECT 0\r\n", b"Serial2WiFi APP\r\n",
        b"Disassociation Event\r\n", b"WSTATE=CONNECTED", b'SSID="robots"\r\n', b"INVALID ",
    ),
}  # fmt: skip
_HEADERS = (
    b"\xa5\x12\0\0\0\x05\0\xe8", b"\xa5\x15\0\0\0\x05\0\xe5hello", b"\xa5\x11\0\0\0\x04\0\xea",
    b"\xa5\x13\0\0\0\0\0\xec", b"\xa5\x14\0\0\0\0\0\xeb", b"\xa5", b"\xf5" * 8, b"\xff" * 20,
    b"\xa5\x12\0\0\0\xdc\x05\x0c",
)  # fmt: skip


def seeds() -> Iterator[tuple[str, bytes]]:
    def ms(number: int) -> bytes:
        return number.to_bytes(2, "little")

    common = [(SEND, b"one"), (COMES, b"two"), (RECEIVE, ms(50)), (TIME, ms(500))]
    for options, name in ((0x40, "esp"), (0x42, "nonos"), (0x41, "gs"), (0x43, "sender")):
        kind = options & 1
        yield f"{name}_talks", bytes((options,)) + records.pack(common * 3)
        yield (
            f"{name}_opens",
            bytes((options,))
            + records.pack(
                [(OPEN, b""), (OPEN | 8, b""), *common, (OPEN | 8, b""), (TIME, ms(3000)), *common]
            ),
        )
        faults = [(FAULT | number << 3, b"") for number in range(8)]
        yield (
            f"{name}_faults",
            bytes((options,))
            + records.pack(
                [
                    step
                    for fault in faults
                    for step in (fault, (SEND, b"x"), (TIME, ms(2000)), fault)
                ]
            ),
        )
        steps = [(SAY, word) for word in _WORDS[kind]]
        yield (
            f"{name}_says",
            bytes((options,))
            + records.pack(
                [step for word in steps for step in (word, (SEND, b"x"), (RECEIVE, ms(20)))]
            ),
        )
    yield "esp_small", b"\x50" + records.pack([*common, (LINE, b"\0\0\x01\xff\0\x80"), *common])
    yield (
        "gs_bus",
        b"\x41"
        + records.pack(
            [step for raw in _HEADERS for step in ((LINE, raw), (SEND, b"x"), (TIME, ms(100)))]
        ),
    )
    # A scripted modem, whose answers do not depend on the requests.
    script = [step for _ in range(12) for step in ((SAY, b"\r\nOK\r\n"), (TIME, ms(40)))]
    yield "esp_script", b"\0" + records.pack([(FAULT, b""), (FAULT | 8, b""), *script])
    for options, name in ((0x40, "esp"), (0x41, "gs")):
        yield (
            f"{name}_floods",
            bytes((options,))
            + records.pack(
                [(SAY, b"\r\nOK\r\n" * 40), (RECEIVE, ms(1)), (SAY, b"x" * 400), (TIME, ms(500))]
            ),
        )
    yield (
        "esp_prompts",
        b"\x40"
        + records.pack(
            [
                (FAULT | 3 << 3, b""),
                (SEND, b"abc"),
                (SAY, b"> "),
                (RECEIVE, ms(1)),
                (SAY, b"ERROR\r\n"),
            ]
        ),
    )


def _words(chance: Random, kind: int) -> bytes:
    return b"".join(chance.choice(_WORDS[kind]) for _ in range(chance.choice((1, 1, 2, 5))))


def mutate(data: bytes, random: Random, mutate_bytes: records.MutateBytes) -> bytes:
    head = data[:1] or b"\x40"
    if random.random() < 0.1:
        head = bytes((random.randrange(256),))
    kind = head[0] & 1
    material: list[records.Record] = [
        (SAY, _words(random, kind)),
        (SAY, _words(random, kind)),
        (SEND, bytes(random.choice((0, 1, 5, MTU, MTU + 1)))),
        (RECEIVE, bytes((random.choice((0, 1, 99)), 0))),
        (OPEN | random.choice((0, 8)), b""),
        (TIME, random.choice((1, 30, 150, 400, 2000, 30_000)).to_bytes(2, "little")),
        (COMES, bytes(random.choice((1, 9, MTU, MTU + 1)))),
        (FAULT | random.randrange(8) << 3, b""),
        (LINE, random.choice(_HEADERS) if kind else random.randbytes(random.choice((1, 9, 60)))),
    ]

    def change(op: int, body: bytes) -> bytes:
        draw = random.random()
        if op & 7 in (SAY, LINE) and draw < 0.6:
            at = random.randrange(len(body) + 1)
            word = random.choice(_HEADERS) if op & 7 == LINE else _words(random, kind)
            return body[:at] + word + body[at + random.choice((0, 0, 1, 4)) :]
        return mutate_bytes(body)

    return head + records.mutate(data[1:], random, OPS, material, change)
