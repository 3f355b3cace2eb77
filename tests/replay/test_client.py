"""Replays every recorded conversation with the client of uros in the place of the C client.

The client receives the recorded agent's messages. Its own messages must equal those of the C client
byte by byte, except ACKNACKs, HEARTBEATs and padding. At the end it must have the same state: the
same samples in the same order, and the same sequence numbers of its streams.
"""

import pytest
from support import conversation
from support.board import FakeClock
from support.recorder import Recorder
from support.replay import CAPTURES, load, messages
from uros.interfaces.builtin_interfaces.msg import Time
from uros.interfaces.sensor_msgs.msg import CompressedImage, RelativeHumidity, Temperature
from uros.interfaces.std_msgs.msg import Int32
from uros.interfaces.std_srvs.srv import Trigger

from uros.client import AGENT_CONNECTED, Node
from uros.transport.serial import StreamTransport
from uros.wire import data, ids, session
from uros.wire.cdr import Reader
from uros.wire.framing import Deframer
from uros.wire.header import pull_header

NAMES = sorted(path.stem for path in CAPTURES.glob("*.jsonl"))
ACKNOWLEDGEMENTS = (ids.ACKNACK, ids.HEARTBEAT)


def clients(name):
    return sorted({record.client for record in load(name)})


CLIENTS = [(name, client) for name in NAMES for client in clients(name)]


def talk(name, client):
    """(from the client, message) of one client's conversation, in order."""
    records = [record for record in load(name) if record.client == client]
    out = []
    ends = {True: iter(messages(name, records, True)), False: iter(messages(name, records, False))}
    if not name.startswith(("serial", "tcp")):
        for record in records:
            out.append((record.from_client, next(ends[record.from_client])[1]))
        return out
    # Frames: a message is placed at the record that completes it.
    for record in records:
        before = records[: records.index(record)]
        for side in (True, False):
            if record.from_client == side:
                whole = len(list(messages(name, [*before, record], side)))
                count = len(list(messages(name, before, side)))
                for _ in range(whole - count):
                    out.append((side, next(ends[side])[1]))
    return out


def parts(message):
    """(header, [(kind, flags, values, length)]) of a message, without padding."""
    head, submessages = conversation.unpack(message)
    out = []
    for kind, flags, payload in submessages:
        values = conversation.decode(kind, flags, payload)
        if kind == ids.CREATE and values[3] == ids.IN_BINARY:
            size = len(values[4])
            values[4] = (size, conversation.decode_binary(values[2], values[4]))
        out.append((kind, flags, values, len(payload)))
    return head, out


def kind_of(message):
    return message[pull_header(message, len(message))[4]]


def is_acknowledgement(message):
    return kind_of(message) in ACKNOWLEDGEMENTS


class Raw:
    """A message of which only the octets are known, without a type."""

    _TYPE = "raw"

    def __init__(self, octets):
        self.octets = octets

    def cdr_size(self):
        return len(self.octets)

    def pack_into(self, buf, offset, start):
        buf[offset:] = self.octets


def test_all_captures_are_here():
    assert len(NAMES) == 17 and len(CLIENTS) == 19


# --- the session alone -------------------------------------------------------------------------


class Player:
    """Repeats a recorded client's calls with a Session of uros."""

    def __init__(self, name, client):
        self.talk = talk(name, client)
        self.session = None
        self.whole = b""  # of the fragments that are being sent
        self.acknacks = []  # the ACKNACK of our session after each message
        self.now = 0

    def open(self, message):
        """A Session with the properties of the recorded one."""
        values = parts(message)[1][0][2]
        key, session_id, mtu = values[3], values[4], values[6]
        self.session = Recorder(key, mtu, 100000)
        assert self.session.id == session_id

    def play(self):
        for from_client, message in self.talk:
            if self.session is None:
                first = [
                    message
                    for from_client, message in self.talk
                    if from_client and kind_of(message) == ids.CREATE_CLIENT
                ]
                self.open(first[0])
            self.now += 1
            if from_client:
                self.do(message)
            else:
                self.session.receive(message, self.now)
                self.acknacks.append(self.session._in.acknack())

    def do(self, message):
        (session_id, stream, _, _), submessages = conversation.unpack(message)
        kind, flags, payload = submessages[0]
        client_session = self.session
        if kind == ids.CREATE_CLIENT:
            client_session.create_session()
        elif kind == ids.GET_INFO:
            client_session.ping(session_id != ids.SESSION_NONE_WITHOUT_KEY)
        elif kind == ids.TIMESTAMP:
            client_session.ask_time(*session.pull_timestamp(Reader(payload, 0, 8)))
        elif kind == ids.ACKNACK:
            first, missing, _ = session.pull_acknack(Reader(payload, 0, len(payload)))
            assert (first, missing) in self.acknacks  # not always the last: messages crossed
        elif kind == ids.HEARTBEAT:
            first, last, _ = session.pull_heartbeat(Reader(payload, 0, len(payload)))
            assert first <= client_session.acked and last == client_session.next - 1
        elif kind == ids.FRAGMENT:
            if not self.whole:  # all of them, with the first
                at = self.talk.index((True, message))
                self.whole = whole = fragments_from(self.talk[at:])
                client_session.request_id = whole[4] << 8 | whole[5]
                client_session.write(whole[6] << 8 | whole[7], Raw(whole[8:]), b"", True)
            if flags & ids.FLAG_LAST_FRAGMENT:
                self.whole = b""
        elif len(submessages) > 1:  # several requests in one message; our client never sends that
            client_session.defer(bytearray(message))
        elif kind == ids.DELETE and stream == ids.STREAM_NONE:
            client_session.delete_session()
        else:
            self.request(kind, flags, stream, payload)

    def request(self, kind, flags, stream, payload):
        client_session = self.session
        client_session.request_id = payload[0] << 8 | payload[1]
        object_id = payload[2] << 8 | payload[3]
        if kind == ids.WRITE_DATA:
            prefix = b""
            if object_id & 15 == ids.KIND_REPLIER:
                prefix = payload[4 : 4 + data.SAMPLE_IDENTITY_SIZE]
            rest = Raw(payload[4 + len(prefix) :])
            client_session.write(object_id, rest, prefix, stream >= ids.STREAM_RELIABLE)
            return

        w = client_session.begin(object_id)
        w.octets(payload[4:])
        client_session.request(kind, flags, w)

    def expected_events(self):
        """The expected callbacks: each reliable message once, in order."""
        seen = {}
        out = []
        for from_client, message in self.talk:
            if from_client or is_acknowledgement(message):
                continue
            (_, stream, sequence, _), submessages = conversation.unpack(message)
            if stream and seen.setdefault((stream, sequence), message) is not message:
                continue
            for kind, flags, payload in submessages:
                values = conversation.decode(kind, flags, payload)
                if kind == ids.STATUS:
                    out.append(("status", values[0], values[2]))
                elif kind == ids.DATA:
                    thing = payload[2] << 8 | payload[3]
                    out.append(("data", thing, payload[4:], True))
                elif kind == ids.STATUS_AGENT:
                    out.append(("agent", values[0]))
                elif kind == ids.TIMESTAMP_REPLY:
                    out.append(("time", values[0], values[1]))
                elif kind == ids.INFO and message[0] == ids.SESSION_NONE_WITHOUT_KEY:
                    out.append(("pong",))
        return out


@pytest.mark.parametrize(("name", "client"), CLIENTS, ids=[f"{n}-{c}" for n, c in CLIENTS])
def test_the_session_ends_where_the_recorded_one_did(name, client):
    player = Player(name, client)
    player.play()
    theirs = [
        message
        for from_client, message in player.talk
        if from_client and not is_acknowledgement(message)
    ]
    ours = [bytes(message) for message in player.session.sent]
    if any(kind_of(message) == ids.FRAGMENT for message in theirs):
        assert reassembled(ours) == reassembled(theirs)
    else:
        decoded = [parts(message) for message in ours]
        # The request id in our DELETE of the session differs.
        for head, submessages in decoded:
            if submessages[0][0] == ids.DELETE and head[1] == ids.STREAM_NONE:
                submessages[0][2][0] = delete_request_id(theirs)
        assert decoded == [parts(message) for message in theirs]
    assert player.session.events == player.expected_events()
    client_session = player.session
    assert client_session.dropped == 0
    acknacks = {True: [], False: []}
    for from_client, message in player.talk:
        if kind_of(message) == ids.ACKNACK:
            payload = conversation.unpack(message)[1][0][2]
            acknacks[from_client].append(session.pull_acknack(Reader(payload, 0, len(payload))))
    if acknacks[False]:
        assert client_session.acked == acknacks[False][-1][0]
    if acknacks[True]:
        # The recorder was stopped before some clients had acknowledged the last messages.
        assert (client_session._in.next - acknacks[True][-1][0]) & 0xFFFF <= 3


def fragments_from(talk):
    """The submessage in the client's fragments, from the first message of ``talk`` on."""
    whole = b""
    for from_client, message in talk:
        if from_client and kind_of(message) == ids.FRAGMENT:
            _, flags, payload = conversation.unpack(message)[1][0]
            whole += payload
            if flags & ids.FLAG_LAST_FRAGMENT:
                return whole
    raise AssertionError("the last fragment was not recorded")


def delete_request_id(theirs):
    """The request id of the recorded DELETE of the session."""
    for message in theirs:
        head, submessages = parts(message)
        if submessages[0][0] == ids.DELETE and head[1] == ids.STREAM_NONE:
            return submessages[0][2][0]
    raise AssertionError("no DELETE of the session was recorded")


def reassembled(sent):
    """(stream, kind, flags, payload) of the submessages, with fragments reassembled."""
    out = []
    whole = b""
    for message in sent:
        head, submessages = conversation.unpack(message)
        for kind, flags, payload in submessages:
            if kind == ids.FRAGMENT:
                whole += payload
                if flags & ids.FLAG_LAST_FRAGMENT:
                    out.append((head[1], whole[0], whole[1], whole[2:]))
                    whole = b""
            elif kind == ids.CREATE:
                out.append((head[1], kind, flags, parts(message)))
            elif kind != ids.DELETE or head[1]:  # our DELETE has another request id
                out.append((head[1], kind, flags, payload))
    return out


# --- the node in the place of micro-ROS ---------------------------------------------------------


class RecordedAgent:
    """A transport with the recorded agent at its other end.

    It answers when the board has sent as many reliable messages as the recorded client. It also
    answers requests that the recorded client never sent: a ping before the session, TIMESTAMP.
    """

    def __init__(self, name, client, clock):
        self.talk = talk(name, client)
        self.mtu = 508
        self.clock = clock
        self.sent = []  # reliable messages, each once
        self.inbox = []
        self.acked = 0
        self._at = 0

    def open(self):
        pass

    def close(self):
        pass

    def send(self, message, size):
        message = bytes(memoryview(message)[:size])
        _, stream, number, _, start = pull_header(message, len(message))
        kind = message[start]
        if kind == ids.GET_INFO:
            self.answer(message, ids.INFO, lambda w: session.push_info(w, 10, 0xFFFD, 0, 1, []))
        elif kind == ids.TIMESTAMP:
            own = conversation.unpack(message)[1][0][2]
            originate = session.pull_timestamp(Reader(own, 0, 8))
            now = (1700000000 + self.clock.t // 1000000, self.clock.t % 1000000 * 1000)
            self.answer(
                message, ids.TIMESTAMP_REPLY,
                lambda w: session.push_timestamp_reply(w, now, now, originate),
            )  # fmt: skip
        elif kind == ids.CREATE_CLIENT:
            self.create_client = message
            self.until_client()
        elif stream == ids.STREAM_RELIABLE and number == len(self.sent):
            self.sent.append(message)
            self.until_client()

    def answer(self, question, kind, push):
        w = conversation.header.MessageWriter(bytearray(128), question[0], 0, 0)
        w.begin(kind)
        push(w)
        self.inbox.append(w.finish())

    def until_client(self):
        """Post the agent's messages that precede the client's next reliable message."""
        sent = 0
        while self._at < len(self.talk):
            from_client, message = self.talk[self._at]
            if from_client and message[0] & 0x80 and message[1] == ids.STREAM_RELIABLE:
                number = message[2] | message[3] << 8
                if number >= len(self.sent):
                    return
                sent = number
            elif not from_client and kind_of(message) != ids.TIMESTAMP_REPLY:
                self.inbox.append(message)
            self._at += 1
        assert sent >= 0

    def receive(self, timeout_ms):
        if not self.inbox:
            self.hurry()
        if self.inbox:
            return self.inbox.pop(0)
        self.clock.sleep(timeout_ms)
        return None

    def hurry(self):
        """Post the next ACKNACK: the recorded client had more in flight than our window."""
        for from_client, message in self.talk[self._at :]:
            if not from_client and kind_of(message) == ids.ACKNACK:
                first = message[8] | message[9] << 8
                if self.acked < first <= len(self.sent):
                    self.acked = first
                    self.inbox.append(message)
                    return

    def theirs(self):
        """The recorded client's reliable messages up to its first DELETE."""
        out = []
        for from_client, message in self.talk:
            if from_client and message[0] & 0x80 and message[1] == ids.STREAM_RELIABLE:
                kind, _, payload = conversation.unpack(message)[1][0]
                if kind == ids.DELETE or kind == ids.READ_DATA and payload[8:10] == b"\0\0":
                    break
                number = message[2] | message[3] << 8
                if number == len(out):
                    out.append(message)
        return out


class Play:
    """A node of uros in the place of a capture's client."""

    def __init__(self, capture, client, name, namespace=""):
        self.clock = FakeClock()
        self.agent = RecordedAgent(capture, client, self.clock)
        create_client = [
            message
            for from_client, message in self.agent.talk
            if from_client and message[4] == ids.CREATE_CLIENT
        ][0]
        self.their_create_client = create_client
        key = parts(create_client)[1][0][2][3]
        self.node = Node(name, self.agent, namespace, key=key, clock=self.clock)

    def connect(self):
        for _ in range(100):
            if self.node.state == AGENT_CONNECTED:
                return
            self.node.spin_once(0.01)
        raise AssertionError(self.node.connection.reason)

    def spin(self, rounds=50):
        for _ in range(rounds):
            self.node.spin_once(0.001)

    def writes(self):
        """The samples of the recorded client: (object id, octets)."""
        out = []
        for kind, payload in [
            (kind, payload)
            for message in self.agent.theirs()
            for kind, _, payload in conversation.unpack(message)[1]
        ]:
            if kind == ids.WRITE_DATA:
                out.append((payload[2] << 8 | payload[3], payload[4:]))
        return out

    def check(self):
        assert self.agent.create_client == self.their_create_client
        ours, theirs = self.agent.sent, self.agent.theirs()
        assert [parts(message) for message in ours] == [parts(message) for message in theirs]
        assert self.node.state == AGENT_CONNECTED
        assert self.node.connection.held() == 0
        assert self.node.connection.dropped == 0


def read(type, octets):
    return type.unpack_from(octets, 0, 0, len(octets))[0]


@pytest.mark.parametrize(
    ("capture", "name", "namespace", "topics"),
    [
        ("rclc_int32_publisher", "int32_pub_node", "", [(Int32, "std_msgs_msg_Int32")]),
        (
            "rclc_temperature_humidity", "weather", "garden",
            [(Temperature, "temperature"), (RelativeHumidity, "/garden/humidity")],
        ),
        ("rclc_time_sync", "time_sync_node", "", [(Time, "synced_time")]),
    ],
)  # fmt: skip
def test_publishers_send_what_those_of_micro_ros_sent(capture, name, namespace, topics):
    play = Play(capture, 0, name, namespace)
    publishers = [play.node.create_publisher(*topic, 10) for topic in topics]
    play.connect()
    samples = play.writes()
    assert len(samples) >= 3
    for object_id, octets in samples:
        publisher = publishers[object_id >> 4]
        assert publisher.publish(read(publisher.type, octets))
        play.spin(3)
    play.check()


def test_a_subscription_receives_what_that_of_micro_ros_received():
    play = Play("rclc_int32_subscriber", 0, "int32_sub_node")
    numbers = []
    play.node.create_subscription(
        Int32, "std_msgs_msg_Int32", lambda message: numbers.append(message.data)
    )
    play.connect()
    play.spin()
    assert numbers == list(range(16))
    play.check()
    assert play.node.connection._in.acknack() == (20, 0)


def test_a_service_answers_as_that_of_micro_ros_did():
    play = Play("rclc_trigger", 0, "trigger_server_node")
    requests = []

    def trigger(request, response):
        requests.append(request)
        response.success = True
        response.message = f"triggered {len(requests)}"
        return response

    play.node.create_service(Trigger, "trigger", trigger)
    play.connect()
    play.spin()
    assert len(requests) == len(play.writes()) >= 3
    play.check()


def test_a_client_calls_as_that_of_micro_ros_did():
    play = Play("rclc_trigger", 1, "trigger_client_node")
    client = play.node.create_client(Trigger, "trigger")
    play.connect()
    answers = []
    for _ in play.writes():
        future = client.call_async(Trigger.Request())
        play.spin(5)
        answers.append(future.result().message)
    assert answers == [f"triggered {i + 1}" for i in range(len(play.writes()))]
    play.check()


def test_an_image_is_sent_as_by_micro_ros():
    play = Play("rclc_image", 0, "image_pub_node")
    publisher = play.node.create_publisher(CompressedImage, "image/compressed")
    play.connect()
    theirs = play.agent.theirs()
    wholes = [part for part in reassembled(theirs) if part[1] == ids.WRITE_DATA]
    assert len(wholes) >= 2
    for _, _, _, octets in wholes:
        image = read(CompressedImage, octets[6:])
        assert image.format == "jpeg" and len(image.data) == 15000
        assert publisher.publish(image)
        play.spin()
    ours = [part for part in reassembled(play.agent.sent) if part[1] == ids.WRITE_DATA]
    assert len(play.agent.sent) == len(theirs)
    assert [len(message) for message in play.agent.sent[4:]] == [
        len(message) for message in theirs[4:]
    ]
    for own, recorded in zip(ours, wholes, strict=True):
        assert own[:3] == recorded[:3] and own[3][:6] == recorded[3][:6]
        # The padding of C clients is uninitialized.
        assert read(CompressedImage, own[3][6:]) == read(CompressedImage, recorded[3][6:])
    assert play.node.connection.held() == 0


# --- serial lines-------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["serial_publish", "serial_ping"])
def test_frames_equal_the_recorded_ones(name):
    """A StreamTransport decodes the recorded bytes, and writes them, octet by octet."""

    class Port:
        def __init__(self, incoming):
            self.incoming = incoming
            self.written = b""

        def read(self, size):
            chunk = self.incoming[:3]  # never a whole frame
            self.incoming = self.incoming[3:]
            return chunk

        def write(self, octets):
            self.written += bytes(octets[:7])
            return min(7, len(octets))

    def line(from_client):
        return b"".join(record.data for record in load(name) if record.from_client == from_client)

    port = Port(line(False))
    transport = StreamTransport(port, address=1)
    transport.open()
    received = []
    message = transport.receive(0)
    while message is not None:
        received.append(message)
        message = transport.receive(0)
    assert received == [message for _, message in messages(name, load(name), False)]
    for _, message in messages(name, load(name), True):
        transport.send(message)
        for _ in range(len(message)):
            transport.receive(0)
    assert port.written == line(True)
    assert Deframer(0).feed(port.written) == [
        message for _, message in messages(name, load(name), True)
    ]
