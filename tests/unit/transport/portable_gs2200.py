"""The transport over a GS2200 on SPI, on a modelled one. Also runs on MicroPython."""

from support.board import pattern
from support.modem import (
    AGENT,
    NETWORK,
    PASSWORD,
    FakeTime,
    Setup,
    attempts,
    drain,
    drops_messages_that_are_too_long,
    exchange,
    failure,
    in_order,
    link_up,
    one_by_one,
    opened,
)

from uros.boards.virtual.modems.gs2200 import Gs2200
from uros.boards.virtual.modems.radio_network import RadioNetwork
from uros.transport.gs2200 import Gs2200Transport


class Place(Setup):
    """``options`` are the modem's."""

    def __init__(self, time, ssid=NETWORK, password=PASSWORD, mtu=512, cs=None, **options):
        self.network = RadioNetwork({NETWORK: PASSWORD})
        self.modem = Gs2200(self.network, time.ticks_ms, **options)
        self.transport = self.again(ssid, password, mtu, cs)

    def again(self, ssid=NETWORK, password=PASSWORD, mtu=512, cs=None):
        modem = self.modem
        return Gs2200Transport(modem, modem, ssid, password, AGENT, mtu=mtu, cs=cs)


MESSAGES = (
    b"\x80\x00\x00\x00",
    b"\r\nOK\r\n",
    b"\r\nERROR\r\n\x1bZ00003abc\x1bF\x1by0\r\nSerial2WiFi APP\r\n",
    b"\xa5\x01\x00\xf5\x1b",
    pattern(512, 1),
    b"0",
)


def test_headers_of_transfers() -> None:
    # By hand, after Sony's driver in NuttX: start, class, reserved, two octets of information, the
    # length from its low octet on, and the complement of the sum of all but the start.
    class Bus:
        written = b""

        def write(self, data):
            self.written += bytes(data)

        def value(self):
            return 0

    bus = Bus()
    with FakeTime():
        transport = Gs2200Transport(bus, bus, NETWORK, PASSWORD, AGENT)
        transport.open()
        transport.receive(0)
    assert bus.written == bytes.fromhex("a5010000000400fa")  # AT, CR, LF


def test_datagrams_are_exchanged() -> None:
    for sender in (False, True):
        with FakeTime() as time:
            place = Place(time, sender=sender)
            link_up(place.transport)
            assert place.modem.joined == NETWORK
            assert place.link.address == (AGENT, 8888, 10001)
            one_by_one(place, MESSAGES)
            assert place.modem.broken == 0


def test_datagrams_of_other_senders_are_skipped() -> None:
    with FakeTime() as time:
        place = Place(time)
        link_up(place.transport)
        for text in (
            b"\x1bZ10003abc",
            b"\x1by0192.168.1.11 8888\t0003abc",
            b"\x1by0192.168.1.10 8887\t0003abc",
            b"\x1by1192.168.1.10 8888\t0003abc",
        ):
            place.modem.emit(text)
            place.link.incoming.append(b"ours")
            assert drain(place.transport) == [b"ours"], text
        place.modem.emit(b"\x1by0192.168.1.10 8888\t0003abc\x1bZ00002de")
        assert drain(place.transport) == [b"abc", b"de"]
        assert place.transport.malformed == 4  # foreign datagrams, too


def test_malformed_heads_are_ignored() -> None:
    with FakeTime() as time:
        place = Place(time)
        link_up(place.transport)
        for text in (
            b"\x1bZ0abcd", b"\x1bZ0 123", b"\x1bZ0000", b"\x1bx", b"\x1b\x1b\x1b", b"\x1bO",
            b"\x1by0" + b"1" * 60, b"\x1bZ00000", b"\x1bZ0-123",
        ):  # fmt: skip
            place.modem.emit(text + b"\r\n\r\n\r\n\r\n")
            place.link.incoming.append(b"ours")
            assert drain(place.transport)[-1:] == [b"ours"], text


def test_datagrams_stay_in_order() -> None:
    with FakeTime() as time:
        in_order(Place(time), [pattern(n, n) for n in range(1, 500, 7)], 10)


def test_gs2200_open_does_not_wait_for_the_network() -> None:
    with FakeTime() as time:
        place = Place(time, key_ms=4000, join_ms=6000, answer_ms=3)
        took, turns = opened(place, time, 25)
        assert took < 10500 and turns > 100


def test_a_wrong_password_and_an_unknown_network_are_reported() -> None:
    for ssid, password in ((NETWORK, "wrong999"), ("elsewhere", PASSWORD)):
        with FakeTime() as time:
            place = Place(time, ssid, password)
            place.transport.open()
            text = failure(place.transport)
            assert "cannot join " + ssid in text and "password" in text, text
            place.transport.close()
            place.transport = place.again()
            link_up(place.transport)
            assert exchange(place, [b"hello"]) == [b"hello"]


def test_invalid_names_passwords_and_hosts_are_refused() -> None:
    with FakeTime() as time:
        place = Place(time, password="short")
        place.transport.open()
        assert "refuses the password" in failure(place.transport)
    for options in (("a,b", "x" * 8), ("a", 'x"' * 8), ("", "x"), ("n" * 33, "x")):
        try:
            Gs2200Transport(None, None, *options, AGENT)
        except ValueError:
            continue
        raise AssertionError(options)
    for host in ("agent.local", "1.2.3", "1.2.3.256", "", "::1"):
        try:
            Gs2200Transport(None, None, "a", "b", host)
        except ValueError as error:
            assert "address" in str(error)
        else:
            raise AssertionError(host)


def test_a_silent_gs2200_is_reported() -> None:
    with FakeTime() as time:
        place = Place(time)
        place.modem.faults.add("dead")
        place.transport.open()
        before = time.now
        text = failure(place.transport)
        assert "does not answer" in text and "GPIO37" in text, text
        assert time.now - before < 16000
        place.transport.close()
        place.modem.faults.clear()
        link_up(place.transport)


def test_a_gs2200_just_switched_on() -> None:
    with FakeTime() as time:
        place = Place(time)
        place.modem.reset()
        link_up(place.transport)
        assert exchange(place, [b"hello"]) == [b"hello"]


def test_a_modem_in_the_middle_of_a_transfer_is_recovered() -> None:
    """A program was reset while it sent: the modem expects the rest of the transfer."""
    for left in (1, 4, 8, 100, 519):
        with FakeTime() as time:
            place = Place(time)
            link_up(place.transport)
            place.modem._want = left
            place.modem._came = bytearray(527 - left)
            place.transport = place.again()
            link_up(place.transport)
            assert exchange(place, [b"hello"]) == [b"hello"]


def test_a_joined_gs2200_does_not_join_again() -> None:
    with FakeTime() as time:
        place = Place(time, join_ms=5000)
        link_up(place.transport)
        for _ in range(3):
            place.transport.close()
            before = time.now
            link_up(place.transport)
            assert time.now - before < 300
        assert (
            len([command for command in place.modem.commands if command.startswith(b"AT+WA=")]) == 1
        )
        assert [link.closed for link in place.network.links] == [True, True, True, False]


def test_datagrams_received_during_a_write_request() -> None:
    """A datagram arrives between the two halves of a write request, and after it."""
    with FakeTime() as time:
        place = Place(time)
        link_up(place.transport)
        write = place.modem.write
        halves = []

        def meanwhile(data):
            write(data)
            if len(data) == 4 and len(halves) < 6:
                halves.append(1)
                place.link.incoming.append(b"meanwhile %d" % len(halves))

        place.modem.write = meanwhile
        received = []
        for n in range(5):
            place.transport.send(pattern(100, n))
            received += drain(place.transport)
        assert place.link.sent == [pattern(100, n) for n in range(5)]
        assert received == [b"meanwhile %d" % (n + 1) for n in range(len(halves))] and halves


def test_slow_answers_to_transfer_requests() -> None:
    with FakeTime() as time:
        place = Place(time, turn_ms=3)
        link_up(place.transport)
        assert exchange(place, list(MESSAGES)) == list(MESSAGES)
        assert place.transport.malformed == place.transport.mute == 0


def test_a_refused_transfer_is_requested_again() -> None:
    with FakeTime() as time:
        place = Place(time)
        link_up(place.transport)
        place.modem.faults.add("busy")
        place.link.incoming.append(b"come")
        place.transport.send(b"hello")
        for _ in range(20):
            assert place.transport.receive(5) is None
        place.modem.faults.clear()
        assert drain(place.transport) == [b"come"] and place.link.sent == [b"hello"]
        assert place.transport.dropped == 0


def test_a_modem_that_accepts_no_datagrams_is_reported() -> None:
    with FakeTime() as time:
        place = Place(time)
        link_up(place.transport)
        place.modem.faults.add("busy")
        for _ in range(3):
            place.transport.send(b"hello")
        assert "takes nothing" in failure(place.transport)
        assert place.transport.dropped == 3


def test_a_header_read_too_early_is_recovered() -> None:
    with FakeTime() as time:
        place = Place(time)
        link_up(place.transport)
        for _ in range(3):
            place.modem.faults.add("late")
            place.transport.send(b"hello")
            drain(place.transport)
        assert place.link.sent == [b"hello"] * 3
        assert place.transport.malformed >= 3


def test_a_network_lost_by_the_gs2200_is_joined_again() -> None:
    with FakeTime() as time:
        place = Place(time)
        link_up(place.transport)
        place.modem.lose_network()
        assert "lost the network" in failure(place.transport)
        place.transport.close()
        link_up(place.transport)
        assert sorted(exchange(place, MESSAGES)) == sorted(MESSAGES)


def test_a_lost_link_is_reported() -> None:
    with FakeTime() as time:
        place = Place(time)
        link_up(place.transport)
        place.modem.link = None
        place.transport.send(b"hello")
        assert "no link" in failure(place.transport)
        place.transport.close()
        link_up(place.transport)
        place.modem.emit(b"\r\nDISCONNECT 0\r\n")
        assert "closed the link" in failure(place.transport)


def test_a_gs2200_may_restart_at_any_moment() -> None:
    healed = 0
    for moment in range(1, 60):
        with FakeTime() as time:
            place = Place(time)
            write = place.modem.write
            count = [0]

            def cut(data, write=write, place=place, moment=moment, count=count):
                count[0] += 1
                if count[0] == moment:
                    place.modem.reset()
                write(data)

            place.modem.write = cut
            healed += attempts(place, moment)
    assert healed > 5


def test_too_long_datagrams_of_the_gs2200_are_skipped_and_counted() -> None:
    with FakeTime() as time:
        drops_messages_that_are_too_long(Place(time, mtu=64), b"\x1bZ00003abc" * 100)


def test_the_select_pin_is_low_during_transfers() -> None:
    levels = []

    class Pin:
        def value(self, level):
            levels.append(level)

    with FakeTime() as time:
        place = Place(time, cs=Pin())
        write, readinto = place.modem.write, place.modem.readinto

        def selected(call):
            def checked(*arguments):
                assert levels[-1] == 0
                call(*arguments)

            return checked

        place.modem.write = selected(write)
        place.modem.readinto = selected(readinto)
        link_up(place.transport)
        assert exchange(place, [b"hello"]) == [b"hello"]
        assert levels[0] == levels[-1] == 1
