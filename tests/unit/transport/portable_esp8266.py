"""The transport over an ESP8266 with AT firmware, on a modelled one. Also runs on MicroPython."""

from support.board import pattern
from support.modem import (
    AGENT,
    NETWORK,
    PASSWORD,
    FakeTime,
    Line,
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
    os_error,
    until,
)

from uros.boards.virtual.modems.esp8266 import Esp8266
from uros.boards.virtual.modems.radio_network import RadioNetwork
from uros.transport.esp8266 import Esp8266Transport


class Place(Setup):
    """``options`` are the modem's."""

    def __init__(
        self, time, line=None, ssid=NETWORK, password=PASSWORD, mtu=512, room=2048, **options
    ):
        self.network = RadioNetwork({NETWORK: PASSWORD, 'a "b", c\\d': 'x,"y"\\z'}, (AGENT,))
        self.modem = Esp8266(self.network, time.ticks_ms, **options)
        self.line = Line(self.modem, **(line or {}))
        self.transport = Esp8266Transport(
            self.line, ssid, password, AGENT, 8888, mtu=mtu, room=room
        )


MESSAGES = (
    b"\x80\x00\x00\x00",
    b"\r\nOK\r\n",
    b"\r\nERROR\r\n+IPD,5:abcde\r\nSEND OK\r\n> ready\r\nCLOSED\r\n",
    b"\x00\xff\r\n\x1b:>",
    pattern(512, 1),
    b">",
)


def test_datagrams_are_exchanged_in_both_dialects() -> None:
    for dialect in ("esp-at", "nonos"):
        with FakeTime() as time:
            place = Place(time, dialect=dialect)
            link_up(place.transport)
            assert place.modem.joined == NETWORK and b"ATE0" in place.modem.commands
            assert place.link.address == (AGENT, 8888, 0)
            one_by_one(place, MESSAGES)


def test_datagrams_are_exchanged_in_pieces_of_any_size() -> None:
    """The line reads and writes chunks of any size."""
    for size in (1, 2, 3, 5, 7, 13):
        with FakeTime() as time:
            place = Place(time, {"chunk": size, "takes": size})
            link_up(place.transport)
            answers = exchange(place, MESSAGES)
            assert sorted(answers) == sorted(MESSAGES), (size, answers)


def test_datagrams_stay_in_order_and_may_be_joined() -> None:
    with FakeTime() as time:
        in_order(Place(time), [pattern(n, n) for n in range(1, 200, 3)], 20)


def test_esp8266_open_does_not_wait_for_the_network() -> None:
    with FakeTime() as time:
        place = Place(time, join_ms=7000, answer_ms=3, send_ms=2)
        took, turns = opened(place, time, 40)
        assert took < 7500 and turns > 100


def test_special_characters_in_names_and_passwords() -> None:
    with FakeTime() as time:
        place = Place(time, ssid='a "b", c\\d', password='x,"y"\\z')
        link_up(place.transport)
        assert place.modem.joined == 'a "b", c\\d'
        place.transport.close()
        link_up(place.transport)
        joins = [command for command in place.modem.commands if command.startswith(b"AT+CWJAP=")]
        assert len(joins) == 1


def test_a_wrong_password_is_reported() -> None:
    for dialect in ("esp-at", "nonos"):
        with FakeTime() as time:
            place = Place(time, password="wrong", dialect=dialect)
            place.transport.open()
            text = failure(place.transport)
            assert "cannot join robots" in text and "password is wrong" in text, text
            assert not place.transport.linked
            place.transport.close()
            place.network.access_points[NETWORK] = "wrong"
            link_up(place.transport)


def test_an_unknown_access_point_is_reported() -> None:
    with FakeTime() as time:
        place = Place(time, ssid="elsewhere")
        place.transport.open()
        text = failure(place.transport)
        assert "cannot join elsewhere" in text and "no such access point" in text, text


def test_an_unreachable_agent_is_reported() -> None:
    with FakeTime() as time:
        place = Place(time)
        place.network.hosts = ()
        place.transport.open()
        text = failure(place.transport)
        assert "no way to 192.168.1.10, port 8888" in text, text


def test_a_network_without_addresses_is_reported() -> None:
    with FakeTime() as time:
        place = Place(time)
        place.modem.faults.add("no_ip")
        place.transport.open()
        assert "no address" in failure(place.transport)


def test_a_silent_esp8266_is_reported() -> None:
    with FakeTime() as time:
        place = Place(time)
        place.modem.faults.add("dead")
        place.transport.open()
        before = time.now
        text = failure(place.transport)
        assert "does not answer" in text and "baud" in text, text
        assert time.now - before < 4000
        place.modem.faults.clear()
        link_up(place.transport)


def test_the_dialogue_ends_at_the_first_failure() -> None:
    """After a failed join no further command is sent."""
    with FakeTime() as time:
        place = Place(time, password="wrong")
        place.transport.open()
        failure(place.transport)
        assert not [
            command for command in place.modem.commands if command.startswith(b"AT+CIPSTART")
        ]


def test_a_modem_in_the_middle_of_a_datagram_is_recovered() -> None:
    """A program was reset while it sent: the modem expects the rest of the datagram."""
    for left in (1, 2, 3, 100, 511, 512):
        with FakeTime() as time:
            place = Place(time)
            link_up(place.transport)
            place.modem.write(b"AT+CIPSEND=512\r\n" + bytes(512 - left))
            again = Esp8266Transport(place.line, NETWORK, PASSWORD, AGENT)
            link_up(again)
            again.send(b"hello")
            until(again, lambda place=place: place.link.sent[-1:] == [b"hello"])


def test_a_joined_esp8266_does_not_join_again() -> None:
    with FakeTime() as time:
        place = Place(time, join_ms=5000, answer_ms=5)
        link_up(place.transport)
        for _ in range(3):
            place.transport.close()  # the answer to its command is still outstanding
            assert place.modem.link is None
            place.transport.close()
            before = time.now
            link_up(place.transport)
            assert time.now - before < 300
        assert place.transport.mute == 0
        joins = [command for command in place.modem.commands if command.startswith(b"AT+CWJAP=")]
        assert len(joins) == 1
        assert [link.closed for link in place.network.links] == [True, True, True, False]


def test_a_busy_modem_gets_the_command_again() -> None:
    with FakeTime() as time:
        place = Place(time, answer_ms=5, send_ms=40)
        link_up(place.transport)
        place.modem.write(b"AT+CWMODE=1\r\n")  # a command of another program
        place.transport.send(b"hello")
        until(place.transport, lambda: place.link.sent == [b"hello"])
        assert place.transport.dropped == 0


def test_unsolicited_lines_around_each_answer_are_ignored() -> None:
    """Other lines are received before and after each answer."""
    for line in (b"\r\nWIFI CONNECTED\r\n", b"\r\n+STA_CONNECTED:02:00\r\n", b"\r\n\xff\xfe\r\n"):
        with FakeTime() as time:
            place = Place(time)
            hear = place.modem._answer

            def disturbed(text, line=line, hear=hear, place=place):
                place.modem.emit(line)
                hear(text)
                place.modem.emit(line)

            place.modem._answer = disturbed
            link_up(place.transport)
            assert sorted(exchange(place, MESSAGES)) == sorted(MESSAGES)


def test_a_network_lost_by_the_esp8266_is_joined_again() -> None:
    with FakeTime() as time:
        place = Place(time)
        link_up(place.transport)
        place.modem.lose_network()
        text = failure(place.transport)
        assert "closed the link" in text or "lost the network" in text, text
        place.transport.close()
        link_up(place.transport)
        assert sorted(exchange(place, MESSAGES)) == sorted(MESSAGES)


def test_a_network_lost_in_the_middle_of_a_datagram() -> None:
    for dialect in ("esp-at", "nonos"):
        with FakeTime() as time:
            place = Place(time, {"takes": 10}, dialect=dialect, send_ms=10)
            link_up(place.transport)
            place.transport.send(pattern(300))
            until(place.transport, lambda place=place: place.modem._want)
            place.modem.lose_network()
            failure(place.transport)
            place.transport.close()
            link_up(place.transport)
            place.transport.send(b"hello")
            until(place.transport, lambda place=place: place.link.sent[-1:] == [b"hello"])


def test_a_link_lost_silently_is_reported() -> None:
    with FakeTime() as time:
        place = Place(time)
        link_up(place.transport)
        place.modem.link = None
        place.transport.send(b"hello")
        assert "no link" in failure(place.transport)


def test_an_esp8266_may_restart_at_any_moment() -> None:
    """The modem is reset after any number of received octets."""
    with FakeTime() as time:
        place = Place(time)
        link_up(place.transport)
        exchange(place, [b"hello"])
        length = len(place.line.written)
    healed = 0
    for moment in range(1, length, 3):
        with FakeTime() as time:
            place = Place(time)
            write = place.line.write

            def cut(data, write=write, place=place, moment=moment):
                if len(place.line.written) < moment <= len(place.line.written) + len(data):
                    place.modem.reset()
                return write(data)

            place.line.write = cut
            healed += attempts(place, moment)
    assert healed > 5


def test_a_restart_is_reported() -> None:
    with FakeTime() as time:
        place = Place(time)
        link_up(place.transport)
        place.modem.reset()
        assert "started anew" in failure(place.transport)


def test_three_failed_datagrams_in_a_row_are_an_error() -> None:
    with FakeTime() as time:
        place = Place(time)
        link_up(place.transport)
        place.modem.faults.add("full")
        for _ in range(2):
            place.transport.send(b"hello")
            drain(place.transport)
        assert place.transport.dropped == 2
        place.modem.faults.clear()
        exchange(place, [b"hello"])  # a success resets the count
        place.modem.faults.add("full")
        for _ in range(3):
            place.transport.send(b"hello")
        assert "gets rid of nothing" in failure(place.transport)


def test_a_missing_answer_loses_one_datagram() -> None:
    with FakeTime() as time:
        place = Place(time)
        link_up(place.transport)
        place.modem.faults.add("stuck")
        place.transport.send(b"lost")
        until(place.transport, lambda: place.transport.mute)
        place.modem.faults.clear()
        until(place.transport, lambda: place.transport.dropped)
        place.transport.send(b"hello")
        until(place.transport, lambda: place.link.sent[-1:] == [b"hello"])
        assert place.transport.linked and place.transport.dropped == 1


def test_an_incomplete_datagram_is_counted() -> None:
    with FakeTime() as time:
        place = Place(time)
        link_up(place.transport)
        place.modem.emit(b"\r\n+IPD,10:abcdefg")
        assert drain(place.transport) == [] and place.transport.malformed == 1
        place.link.incoming.append(b"whole")
        assert drain(place.transport) == [b"whole"]


def test_too_long_datagrams_of_the_esp8266_are_skipped_and_counted() -> None:
    with FakeTime() as time:
        drops_messages_that_are_too_long(Place(time, mtu=64), b"+IPD,3:abc" * 100)


def test_invalid_lengths_are_ignored() -> None:
    with FakeTime() as time:
        place = Place(time)
        link_up(place.transport)
        for text in (
            b"+IPD,:",
            b"+IPD,-1:",
            b"+IPD,8193:",
            b"+IPD,9999:",
            b"+IPD,99999999999999:",
            b"+IPD,1 2:",
            b"+IPD:",
            b":",
        ):
            place.modem.emit(b"\r\n" + text + b"\r\n")
            place.link.incoming.append(b"whole")
            assert drain(place.transport) == [b"whole"], text


def test_the_send_queue_is_bounded() -> None:
    with FakeTime() as time:
        place = Place(time, room=2000)
        link_up(place.transport)
        messages = [pattern(490, n) for n in range(8)]
        for message in messages:
            place.transport.send(message)
        assert place.transport.dropped == 4
        drain(place.transport)
        assert place.link.sent == messages[:4]
        for turn in range(30):  # more than the size of the queue in total
            place.transport.send(pattern(300, turn))
            place.transport.receive(0)
        drain(place.transport)
        assert place.link.sent[4:] == [pattern(300, turn) for turn in range(30)]
        assert place.transport.dropped == 4


def test_sent_messages_free_their_part_of_the_send_queue() -> None:
    with FakeTime() as time:
        place = Place(time, room=1000, send_ms=5)
        link_up(place.transport)
        messages = [pattern(300, n) for n in range(9)]
        for message in messages[:3]:
            place.transport.send(message)
        for number, message in enumerate(messages[3:]):
            until(place.transport, lambda number=number: len(place.link.sent) > number)
            until(place.transport, lambda: place.transport._to < 3 * 302)
            place.transport.send(message)
        drain(place.transport)
        assert place.link.sent == messages and place.transport.dropped == 0


def test_a_datagram_written_in_parts_is_not_changed_by_queued_ones() -> None:
    with FakeTime() as time:
        place = Place(time, {"takes": 60}, room=2048)
        link_up(place.transport)
        messages = [pattern(500, n) for n in range(60)]
        for datagram in messages:
            for data in (
                datagram,
                datagram[:7],
            ):  # the short one may fit where the long one does not
                place.transport.send(data)
                place.transport.receive(0)
            if not datagram[0] % 3:
                place.transport.receive(2)
        drain(place.transport)
        assert place.transport.dropped and len(place.link.sent) > 10
        for datagram in place.link.sent:
            assert datagram in messages or datagram in [whole[:7] for whole in messages], len(
                datagram
            )


def test_answers_received_during_a_long_callback_are_not_late() -> None:
    """The answer is read after a callback of any length, and in pieces of any size."""
    for chunk in (1, 1000):
        with FakeTime() as time:
            place = Place(time, {"chunk": chunk})
            link_up(place.transport)
            for turn in range(3):
                assert place.transport.receive(0) is None
                place.transport.send(b"one")
                time.now += 60_000
                place.transport.send(b"two")
                time.now += 60_000
                drain(place.transport)
                assert place.link.sent == [b"one", b"two"] * (turn + 1)
            assert place.transport.mute == place.transport.dropped == 0


def test_a_lost_prompt_loses_one_datagram() -> None:
    """The modem waits for the datagram: it gets other octets, and accepts commands again."""
    with FakeTime() as time:
        place = Place(time)
        link_up(place.transport)
        place.line.damage = lambda data: data.replace(b">", b"")
        place.transport.send(b"lost")
        until(place.transport, lambda: place.transport.mute)
        place.line.damage = bytes
        until(place.transport, lambda: place.transport.dropped)
        place.transport.send(b"hello")
        drain(place.transport)
        assert place.link.sent[-1] == b"hello" and place.transport.dropped == 1


def test_an_esp8266_just_switched_on() -> None:
    with FakeTime() as time:
        place = Place(time)
        place.modem.reset()
        link_up(place.transport)
        exchange(place, [b"hello"])


def test_unexpected_answers_are_bounded() -> None:
    with FakeTime() as time:
        place = Place(time)
        link_up(place.transport)
        for _ in range(50):
            place.modem.emit(b"OK\r\nSEND OK\r\n")
            assert place.transport.receive(0) is None
        assert len(place.transport._answers) <= 8
        assert exchange(place, [b"hello"]) == [b"hello"]


def test_the_last_message_before_the_link_is_sent() -> None:
    with FakeTime() as time:
        place = Place(time, join_ms=3000)
        place.transport.open()
        for n in range(5):
            place.transport.send(pattern(20, n))
            place.transport.receive(10)
        until(place.transport, lambda: place.transport.linked)
        drain(place.transport)
        assert place.link.sent == [pattern(20, 4)] and place.transport.dropped == 4


def test_buffers_may_be_reused_after_send() -> None:
    with FakeTime() as time:
        place = Place(time)
        link_up(place.transport)
        buffer = bytearray(b"hello, agent")
        place.transport.send(buffer, 5)
        buffer[:] = b"Hullo, agent"
        place.transport.send(buffer, 12)
        buffer[:] = bytes(12)
        drain(place.transport)
        assert place.link.sent == [b"hello", b"Hullo, agent"]
        assert len(place.transport._out) == 2048


def test_a_closed_transport_raises() -> None:
    with FakeTime() as time:
        place = Place(time)
        assert "not open" in os_error(place.transport.receive, 0)
        assert "not open" in os_error(place.transport.send, b"hello")


def test_a_dialogue_that_failed_restarts_at_open() -> None:
    """After an error, or without memory, each call raises OSError until the transport is opened."""
    for cause in (OSError(5), MemoryError()):
        with FakeTime() as time:
            place = Place(time)
            link_up(place.transport)
            write = place.line.write

            def broken(data, cause=cause):
                raise cause

            place.line.write = broken
            try:
                place.transport.send(b"hello")
            except (OSError, MemoryError) as error:
                assert type(error) is type(cause)
            else:
                raise AssertionError("no error")
            place.line.write = write
            for _ in range(3):
                assert "not open" in os_error(place.transport.receive, 0)
            place.transport.close()
            link_up(place.transport)
            assert exchange(place, [b"hello"]) == [b"hello"]


def test_endless_noise_does_not_block_receive() -> None:
    class Noise:
        reads = 0

        def read(self, size):
            self.reads += 1
            return b"\x00noise\xff+IPD\r\n" * 10

        def write(self, data):
            return len(data)

    with FakeTime():
        transport = Esp8266Transport(Noise(), NETWORK, PASSWORD, AGENT)
        transport.open()
        assert transport.receive(0) is None
        assert Noise.reads == 0 and transport.port.reads < 30


def test_invalid_mtus_and_names_are_refused() -> None:
    for mtu, ssid in ((0, "a"), (1461, "a"), (512, ""), (512, "x" * 33)):
        try:
            Esp8266Transport(None, ssid, "", AGENT, mtu=mtu)
        except ValueError:
            continue
        raise AssertionError((mtu, ssid))


def test_open_wait_and_close_of_the_uart_are_called() -> None:
    calls = []

    class Full(Line):
        def open(self):
            calls.append("open")

        def close(self):
            calls.append("close")

        def wait(self, ms):
            calls.append("wait")
            time.now += ms

    with FakeTime() as time:
        place = Place(time)
        place.transport.port = Full(place.modem)
        link_up(place.transport)
        assert place.transport.receive(5000) is None
        place.transport.close()
        assert calls[0] == "open" and calls[-1] == "close" and "wait" in calls
