"""Transports over modems, fed with any bytes in any pieces at any time."""

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.examples import examples
from support.modem import AGENT, NETWORK, PASSWORD, FakeTime, Line, drain, link_up, until
from support.variants import slow_except

from uros.boards.virtual.modems.esp8266 import Esp8266
from uros.boards.virtual.modems.gs2200 import Gs2200
from uros.boards.virtual.modems.radio_network import RadioNetwork
from uros.transport.esp8266 import Esp8266Transport
from uros.transport.gs2200 import Gs2200Transport

MTU = 64

ESP_WORDS = [
    b"\r\n", b"OK", b"ERROR", b"FAIL", b"SEND OK", b"> ", b"+IPD,", b"+IPD,5:", b":", b"ready",
    b"OK\r\n", b"CLOSED", b"WIFI DISCONNECT", b"busy p...", b"+CWJAP:2", b"9999", b"\x00",
    b"+IPD,0:",
]  # fmt: skip
GS_WORDS = [
    b"\r\n", b"OK", b"ERROR", b"\x1b", b"\x1bZ", b"\x1bZ00005", b"\x1by0", b"\t", b"0003", b"\x1bF",
    b"CONNECT 0", b"DISCONNECT ", b"DISCONNECT 0", b"Serial2WiFi APP", b"Disassoc",
    b"192.168.1.10 8888",
]  # fmt: skip


class Silent:
    """A UART and a bus that receive nothing."""

    def read(self, size):
        return None

    def write(self, data):
        return len(data)

    def value(self, level=None):
        return 0


def esp8266():
    transport = Esp8266Transport(Silent(), NETWORK, PASSWORD, AGENT, mtu=MTU)
    transport.linked = transport._awake = True
    return transport


def gs2200():
    transport = Gs2200Transport(Silent(), Silent(), NETWORK, PASSWORD, AGENT, mtu=MTU)
    transport.linked = transport._awake = True
    transport._cid = ord("0")
    return transport


KINDS = {"esp8266": (esp8266, ESP_WORDS), "gs2200": (gs2200, GS_WORDS)}


def texts(words):
    return st.lists(st.one_of(st.sampled_from(words), st.binary(max_size=20)), max_size=30).map(
        b"".join
    )


def state_of(transport):
    return (
        transport._messages, transport._answers, transport._info, transport._gone,
        transport.malformed, transport._left,
    )  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=examples(300))
@given(data=st.data())
def test_any_bytes_are_parsed_alike_in_any_pieces(kind, data):
    """No exception, no unbounded growth, and the same state for any division into pieces."""
    make, words = KINDS[kind]
    text = data.draw(texts(words))
    cuts = sorted(data.draw(st.lists(st.integers(0, len(text)), max_size=10)))
    whole, pieces = make(), make()
    whole.feed(text)
    for start, stop in zip([0, *cuts], [*cuts, len(text)], strict=True):
        pieces.feed(text[start:stop])
    assert state_of(whole) == state_of(pieces)
    assert all(0 < len(message) <= MTU for message in whole._messages)
    assert len(whole._answers) <= 8 and whole._length <= len(whole._line)
    assert 0 <= whole._left <= 9999


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=examples(200))
@given(data=st.data())
def test_datagrams_between_lines_arrive_complete_and_in_order(kind, data):
    messages = data.draw(st.lists(st.binary(min_size=1, max_size=MTU), max_size=10))
    if kind == "esp8266":
        lines = [b"", b"\r\nSEND OK\r\n", b"\r\nbusy p...\r\n", b"> ", b"\r\n+STA_CONNECTED:02\r\n"]
        coded = [b"\r\n+IPD,%d:%s" % (len(message), message) for message in messages]
    else:
        lines = [b"", b"\r\nOK\r\n", b"MAC=02:00\r\n", b"\x1bO", b"\x1bZ10002no"]
        coded = [b"\x1bZ0%04d%s" % (len(message), message) for message in messages]
    text = b"".join(data.draw(st.sampled_from(lines)) + datagram for datagram in coded)
    size = data.draw(st.integers(1, 50))
    transport = KINDS[kind][0]()
    for at in range(0, len(text), size):
        transport.feed(text[at : at + size])
    assert transport._messages == messages


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=examples(100))
@given(data=st.data())
def test_a_datagram_arrives_after_any_bytes(kind, data):
    """A datagram arrives, at the latest after a gap of the line, or after 9999 bytes."""
    make, words = KINDS[kind]
    transport = make()
    transport.feed(data.draw(texts(words)))
    if kind == "esp8266":
        transport._left = 0  # as after a gap
        transport.feed(b"\r\n+IPD,5:hello")
    else:
        transport.feed(b"\r\n" * 5000)
        transport.feed(b"\x1bZ00005hello")
    assert transport._messages[-1:] == [b"hello"]


class Place:
    """A modem on a line that loses and damages octets while ``rate`` is above 0."""

    def __init__(self, kind, time, seed, rate):
        self.random = random.Random(seed)
        self.rate = rate
        self.network = RadioNetwork({NETWORK: PASSWORD})
        if kind == "esp8266":
            self.modem = Esp8266(self.network, time.ticks_ms, send_ms=1)
            line = Line(self.modem, damage=self.damage)
            write = line.write
            line.write = lambda data: (write(self.damage(bytes(data))), len(data))[1]
            self.transport = Esp8266Transport(line, NETWORK, PASSWORD, AGENT)
        else:
            self.modem = Gs2200(self.network, time.ticks_ms)
            write, readinto = self.modem.write, self.modem.readinto

            def damaged(into, idle=0):
                readinto(into, idle)
                octets = self.damage(bytes(into))[: len(into)]
                into[: len(octets)] = octets

            self.modem.write = lambda data: write(self.damage(bytes(data)))
            self.modem.readinto = damaged
            self.transport = Gs2200Transport(self.modem, self.modem, NETWORK, PASSWORD, AGENT)

    def damage(self, octets):
        out = bytearray()
        for octet in octets:
            dice = self.random.random() / self.rate if self.rate else 3
            if dice < 1:
                out.append(octet ^ 1 << self.random.randrange(8))
            elif dice >= 2:
                out.append(octet)
            # Otherwise the octet is lost.
        return bytes(out)


def opened_until(place, done, turns=100):
    """Receive until ``done``; open the transport again after each failure, as a node does."""
    for _ in range(turns):
        try:
            return until(place.transport, done)
        except OSError:
            place.transport.close()
            place.transport.open()
    raise AssertionError("it never heals")


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", range(8))
def test_datagrams_are_sent_after_noise_on_the_line(kind, seed):
    with FakeTime() as time:
        place = Place(kind, time, seed, 0.0)
        link_up(place.transport)
        place.rate = 0.02
        for turn in range(20):
            place.network.links[-1].incoming.append(b"hello %d" % turn)
            try:
                place.transport.send(bytes(100))
                drain(place.transport)
            except OSError:
                place.transport.close()
                place.transport.open()
        place.rate = 0.0
        for _ in range(10):
            opened_until(place, lambda: place.transport.linked)
            place.transport.send(b"the end")
            began = time.now
            try:
                while time.now - began < 10_000:
                    place.transport.receive(100)
            except OSError:
                place.transport.close()
                place.transport.open()
            if place.network.links[-1].sent[-1:] == [b"the end"]:
                return
        raise AssertionError("it never heals")


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", slow_except(range(3), 0))
def test_joining_over_a_line_with_noise_ends_in_a_link_or_an_error(kind, seed):
    """The dialogue never waits for ever."""
    with FakeTime() as time:
        place = Place(kind, time, seed, 0.02)
        place.transport.open()
        errors = 0
        while not place.transport.linked and errors < 50:
            began = time.now
            try:
                while not place.transport.linked:
                    place.transport.receive(100)
                    assert time.now - began < 150_000
            except OSError:
                errors += 1
                place.transport.close()
                place.transport.open()
        place.rate = 0.0
        opened_until(place, lambda: place.transport.linked)
