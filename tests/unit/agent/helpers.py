"""Boards made of the codecs, and an agent without sockets whose clock the test sets."""

import heapq
import io
import itertools

from uros.agent.agent import Agent
from uros.agent.log import Log
from uros.agent.objects.xml_profiles import References
from uros.agent.transports.base import ServerTransport
from uros.middleware.memory import Bus, MemoryMiddleware
from uros.wire import data, entities, header, ids, session
from uros.wire.cdr import Writer

_NUMBERS = itertools.count()  # break ties between timers that are due at the same time

KEY = 0xAABBCCDD
SESSION = 0x81

OK, MATCHED = ids.STATUS_OK, ids.STATUS_OK_MATCHED
EXISTS, MISMATCH = ids.STATUS_ERR_ALREADY_EXISTS, ids.STATUS_ERR_MISMATCH
UNKNOWN, INVALID = ids.STATUS_ERR_UNKNOWN_REFERENCE, ids.STATUS_ERR_INVALID_DATA
RESOURCES = ids.STATUS_ERR_RESOURCES
REUSE, REPLACE = ids.FLAG_REUSE, ids.FLAG_REPLACE


def sub(kind, payload=b"", flags=ids.FLAG_LITTLE_ENDIAN):
    """One submessage."""
    return kind, flags, bytes(payload)


def message(submessages, stream=ids.STREAM_RELIABLE, sequence=0, session_id=SESSION, key=KEY):
    """One XRCE message: its header and its submessages."""
    out = bytearray(header.header_size(session_id))
    header.push_header(out, session_id, stream, sequence, key)
    for kind, flags, payload in submessages:
        out += bytes(-len(out) % 4)
        head = bytearray(4)
        header.push_subheader(head, 0, kind, flags, len(payload))
        out += head + payload
    return bytes(out)


def parse(datagram):
    """Parse a message into (session id, stream, sequence), [(kind, flags, payload)]."""
    end = len(datagram)
    session_id, stream, sequence, _, at = header.pull_header(datagram, end)
    out = []
    while at + 4 <= end:
        kind, flags, start, stop = header.pull_subheader(datagram, at, end)
        out.append((kind, flags, bytes(datagram[start:stop])))
        at = stop + (-stop & 3)
    return (session_id, stream, sequence), out


def built(push, *values, size=1 << 17):
    """Return the bytes that a push function of the codecs writes."""
    w = Writer(bytearray(size))
    push(w, *values)
    return bytes(memoryview(w.buf)[: w.offset])


def oid(number, kind):
    return number << 4 | kind


# --- submessages ------------------------------------------------------------------


def create_client(key=KEY, session_id=SESSION, mtu=512, properties=None, **more):
    head = ids.SESSION_NONE_WITHOUT_KEY if session_id & 0x80 else ids.SESSION_NONE_WITH_KEY
    payload = built(
        lambda w: session.push_create_client(w, key, session_id, mtu, properties, **more)
    )
    return message([sub(ids.CREATE_CLIENT, payload)], 0, 0, head, key)


def create(object_id, form, content, parent, request=10, flags=0):
    payload = built(entities.push_create, request, object_id, form, content, parent)
    return sub(ids.CREATE, payload, ids.FLAG_LITTLE_ENDIAN | flags)


def xml(object_id, text, parent=0, **more):
    return create(object_id, ids.AS_XML, text, parent, **more)


def by_reference(object_id, name, parent=0, **more):
    return create(object_id, ids.BY_REFERENCE, name, parent, **more)


def delete(object_id, request=20):
    return sub(ids.DELETE, built(session.push_request, request, object_id))


def write_data(object_id, sample, request=30, flags=ids.FLAG_LITTLE_ENDIAN):
    return sub(ids.WRITE_DATA, built(session.push_request, request, object_id) + sample, flags)


def read_data(object_id, stream=ids.STREAM_RELIABLE, control=(0xFFFF, 0, 0, 0), request=40, **more):
    def push(w):
        data.push_read_data(w, request, object_id, stream, control=control, **more)

    return sub(ids.READ_DATA, built(push))


def get_info(object_id=ids.OBJECT_AGENT, request=50):
    return sub(ids.GET_INFO, built(session.push_get_info, request, object_id, ids.INFO_ACTIVITY))


def acknack(first, missing=0, stream=ids.STREAM_RELIABLE):
    return sub(ids.ACKNACK, built(session.push_acknack, first, missing, stream))


def heartbeat(first, last, stream=ids.STREAM_RELIABLE):
    return sub(ids.HEARTBEAT, built(session.push_heartbeat, first, last, stream))


def fragment(part, last=False):
    flags = ids.FLAG_LITTLE_ENDIAN | (ids.FLAG_LAST_FRAGMENT if last else 0)
    return sub(ids.FRAGMENT, part, flags)


def whole(submessage):
    """Return the bytes of a submessage with its header, as fragments carry them."""
    kind, flags, payload = submessage
    out = bytearray(4)
    header.push_subheader(out, 0, kind, flags, len(payload))
    return bytes(out) + payload


# --- entities -----------------------------------------------------------------------

PARTICIPANT = oid(1, ids.KIND_PARTICIPANT)
TOPIC = oid(1, ids.KIND_TOPIC)
PUBLISHER = oid(1, ids.KIND_PUBLISHER)
SUBSCRIBER = oid(1, ids.KIND_SUBSCRIBER)
WRITER = oid(1, ids.KIND_DATAWRITER)
READER = oid(1, ids.KIND_DATAREADER)
REQUESTER = oid(1, ids.KIND_REQUESTER)
REPLIER = oid(1, ids.KIND_REPLIER)
TYPE = oid(1, ids.KIND_TYPE)
QOS = oid(1, ids.KIND_QOS_PROFILE)
APPLICATION = oid(1, ids.KIND_APPLICATION)

INT32 = "std_msgs::msg::dds_::Int32_"
STRING = "std_msgs::msg::dds_::String_"
ADD_REQUEST = "example::srv::dds_::Add_Request_"
ADD_REPLY = "example::srv::dds_::Add_Response_"
RELIABLE_10 = ids.QOS_RELIABLE | ids.QOS_KEEP_LAST


def participant(object_id=PARTICIPANT, name="ns/board", domain=0, **more):
    content = built(entities.push_binary_participant, name, None)
    return create(object_id, ids.IN_BINARY, content, domain, **more)


def topic(object_id=TOPIC, name="rt/chatter", type_name=INT32, parent=PARTICIPANT, **more):
    content = built(entities.push_binary_topic, name, type_name)
    return create(object_id, ids.IN_BINARY, content, parent, **more)


def group(object_id=PUBLISHER, parent=PARTICIPANT, partitions=None, **more):
    content = built(entities.push_binary_group, None, partitions)
    return create(object_id, ids.IN_BINARY, content, parent, **more)


def endpoint(object_id=WRITER, topic_id=TOPIC, parent=PUBLISHER, qos=RELIABLE_10, depth=10, **more):
    reader = object_id & 15 == ids.KIND_DATAREADER
    content = built(lambda w: entities.push_binary_endpoint(w, topic_id, qos, depth, reader=reader))
    return create(object_id, ids.IN_BINARY, content, parent, **more)


def service(object_id=REQUESTER, name="add", parent=PARTICIPANT, **more):
    content = built(
        entities.push_binary_service,
        name, ADD_REQUEST, ADD_REPLY, f"rq/{name}Request", f"rr/{name}Reply",
    )  # fmt: skip
    return create(object_id, ids.IN_BINARY, content, parent, **more)


def publisher_entities(name="rt/chatter", type_name=INT32, **more):
    """A participant with one datawriter."""
    return [participant(**more), topic(name=name, type_name=type_name), group(), endpoint()]


def subscriber_entities(name="rt/chatter", type_name=INT32, depth=10, qos=RELIABLE_10, **more):
    """A participant with one datareader."""
    return [
        participant(**more),
        topic(name=name, type_name=type_name),
        group(SUBSCRIBER),
        endpoint(READER, parent=SUBSCRIBER, depth=depth, qos=qos),
    ]


# --- documents ----------------------------------------------------------------------

TYPES_XML = (
    '<dds><types><struct name="ShapeType"><member name="x" type="int32"/></struct>'
    '<module name="std_msgs"><module name="msg"><module name="dds_">'
    '<struct name="Int32_"><member name="data" type="int32"/></struct>'
    "</module></module></module></types></dds>"
)
QOS_XML = """
<dds><qos_library name="Lib">
  <qos_profile name="slow">
    <datawriter_qos>
      <reliability><kind>BEST_EFFORT_RELIABILITY_QOS</kind></reliability>
      <history><kind>KEEP_LAST_HISTORY_QOS</kind><depth>7</depth></history>
      <deadline><period><sec>2</sec></period></deadline>
      <user_data><value>aGVsbG8=</value></user_data>
    </datawriter_qos>
    <datareader_qos><history><depth>3</depth></history>
      <time_based_filter><minimum_separation><sec>1</sec></minimum_separation></time_based_filter>
    </datareader_qos>
    <publisher_qos><partition><name><element>left</element></name></partition></publisher_qos>
  </qos_profile>
  <qos_profile name="kept" base_name="Lib::slow">
    <datawriter_qos>
      <durability><kind>TRANSIENT_LOCAL_DURABILITY_QOS</kind></durability>
    </datawriter_qos>
  </qos_profile>
</qos_library></dds>
"""
APPLICATION_XML = """
<dds><application_library name="Apps"><application name="arm">
  <domain_participant name="arm/left" domain_id="3" object_id="0x0010">
    <topic name="rt/joints" register_type_ref="T"/>
    <publisher object_id="0x0030">
      <data_writer object_id="0x0040" topic_ref="rt/joints"/>
    </publisher>
    <subscriber>
      <data_reader object_id="80"><topic><name>rt/orders</name><dataType>T</dataType></topic>
      </data_reader>
    </subscriber>
    <data_writer object_id="0x0060" topic_ref="rt/joints"/>
    <replier object_id="0x0070" service_name="s" request_type="A" reply_type="B"/>
  </domain_participant>
  <participant><domainId>4</domainId><rtps><name>right</name></rtps></participant>
</application></application_library></dds>
"""
REFS = """
<profiles>
    <participant profile_name="default_xrce_participant">
        <rtps><name>default_xrce_participant</name></rtps>
    </participant>
    <data_writer profile_name="shapetype_data_writer">
        <topic><kind>WITH_KEY</kind><name>Square</name><dataType>ShapeType</dataType></topic>
    </data_writer>
    <data_reader profile_name="shapetype_data_reader">
        <topic><kind>WITH_KEY</kind><name>Square</name><dataType>ShapeType</dataType></topic>
    </data_reader>
    <topic profile_name="shapetype_topic">
        <kind>WITH_KEY</kind><name>Square</name><dataType>ShapeType</dataType>
    </topic>
    <requester profile_name="shapetype_requester"
               service_name="shapetype_service"
               request_type="request_type"
               reply_type="reply_type">
    </requester>
    <replier profile_name="shapetype_replier"
             service_name="shapetype_service"
             request_type="request_type"
             reply_type="reply_type">
    </replier>
</profiles>
"""


# --- an agent without sockets -----------------------------------------------------------


class Place(ServerTransport):
    """A transport whose peers are numbers and whose network is a list."""

    name = "TestAgent"
    kind = "TEST"

    def __init__(self):
        super().__init__()
        self.sent = []

    def open(self, host):
        pass

    def send(self, peer, datagram):
        self.sent.append((peer, bytes(datagram)))

    def address(self, peer):
        return f"peer {peer}"

    def close(self):
        pass


class Desk:
    """An agent on the memory middleware; the test calls what its thread would call.

    ``clock`` is in milliseconds.
    """

    def __init__(self, bus=None, refs=None, middleware=None, **more):
        self.said = io.StringIO()
        self.middleware = middleware or MemoryMiddleware(bus or Bus())
        self.references = References()
        if refs:
            self.references.load(refs)
        self.agent = Agent(self.middleware, Log(6, self.said), self.references, **more)
        self.clock = 1000
        self.agent.now = lambda: self.clock
        self.timers = []  # [(when, number, call)]
        self.agent.wake_at = self.wake_at
        self.place = Place()
        self.boards = {}  # by peer

    # The interface of a server towards its transports

    def now(self):
        return self.clock

    def received(self, transport, session, buf, view, length, now):
        if session.receive(buf, view, length, now):
            self.agent.attend(session)

    def unmatched(self, transport, peer, buf, view, length):
        self.agent.unmatched(transport, peer, buf, view, length)

    def wake_at(self, seconds, call):
        heapq.heappush(self.timers, (self.clock + round(seconds * 1000), next(_NUMBERS), call))

    # Actions of a test

    def start(self):
        """Start the timers of the agent, as a server does: silent clients are probed."""
        self.agent.start(self.wake_at, [self.place])
        return self

    def hear(self, datagram, peer=1):
        """Deliver a datagram; return everything that the agent sends in response."""
        buf = bytearray(datagram)
        self.place.deliver(self, peer, buf, memoryview(buf), len(buf), self.clock)
        return self.settle()

    def settle(self):
        self.middleware.dispatch()
        while self.agent.attended:
            attended = self.agent.attended.pop()
            attended.finish()
            self.agent.flush(attended)
        sent, self.place.sent = self.place.sent, []
        return sent

    def wait(self, milliseconds):
        """Advance the clock and fire timers; return what the agent sends meanwhile."""
        out = []
        end = self.clock + milliseconds
        while True:
            due = [
                (client.next_deadline(), client)
                for client in self.agent.clients.values()
                if client.next_deadline() is not None and client.next_deadline() <= end
            ]
            at, client = min(due, key=lambda item: item[0], default=(end + 1, None))
            if self.timers and self.timers[0][0] <= min(at, end):
                when, _, call = heapq.heappop(self.timers)
                self.clock = max(self.clock, when)
                call()
            elif client is not None:
                self.clock = max(self.clock, at)
                client.poll(self.clock)
                self.agent.attend(client.session)
            else:
                break
            out += self.settle()
        self.clock = end
        return out

    def log(self):
        return self.said.getvalue()

    def close(self):
        self.agent.close()
        self.middleware.close()


class Board:
    """A client at a desk; if ``polite``, it acknowledges messages on reliable streams."""

    def __init__(self, desk, peer=1, key=KEY, session_id=SESSION, mtu=512, polite=True):
        self.desk = desk
        self.peer = peer
        self.key = key
        self.session_id = session_id
        self.polite = polite
        self.sequence = {}
        self.expected = {}
        self.inbox = []  # (kind, flags, payload)
        self._parts = bytearray()
        answers = [parse(item) for _, item in desk.hear(create_client(key, session_id, mtu), peer)]
        assert [answer[0] for answer in answers[0][1]] == [ids.STATUS_AGENT]
        assert answers[0][1][0][2][0] == ids.STATUS_OK
        desk.boards[peer] = self

    def send(self, *submessages, stream=ids.STREAM_RELIABLE):
        sequence = 0
        if stream:
            sequence = self.sequence.get(stream, 0)
            self.sequence[stream] = (sequence + 1) & 0xFFFF
        self.take(
            self.desk.hear(
                message(submessages, stream, sequence, self.session_id, self.key), self.peer
            )
        )
        return self

    def take(self, sent):
        """Pass the agent's datagrams to their boards in order; boards acknowledge them."""
        while sent:
            peer, datagram = sent.pop(0)
            if peer in self.desk.boards:
                sent += self.desk.boards[peer].look(datagram)

    def look(self, datagram):
        """Read a datagram; return what the agent sends in response to the acknowledgement."""
        (session_id, stream, sequence), submessages = parse(datagram)
        assert session_id == self.session_id
        for kind, flags, payload in submessages:
            if kind == ids.FRAGMENT:
                self._parts += payload
                if flags & ids.FLAG_LAST_FRAGMENT:
                    self.inbox.append((self._parts[0], self._parts[1], bytes(self._parts[4:])))
                    self._parts = bytearray()
            else:
                self.inbox.append((kind, flags, payload))
        if stream < ids.STREAM_RELIABLE:
            return []
        assert sequence == self.expected.get(stream, 0)
        self.expected[stream] = (sequence + 1) & 0xFFFF
        return self.acknowledge(stream) if self.polite else []

    def acknowledge(self, stream=ids.STREAM_RELIABLE):
        answer = acknack(self.expected.get(stream, 0), 0, stream)
        return self.desk.hear(message([answer], 0, 0, self.session_id, self.key), self.peer)

    def wait(self, milliseconds):
        self.take(self.desk.wait(milliseconds))

    def settle(self):
        self.take(self.desk.settle())

    def payloads(self, kind):
        """Remove the payloads of that kind from the inbox; return them in order."""
        payloads = [payload for item, _, payload in self.inbox if item == kind]
        self.inbox = [item for item in self.inbox if item[0] != kind]
        return payloads

    def statuses(self):
        """Remove the status values from the inbox; return them."""
        return [payload[4] for payload in self.payloads(ids.STATUS)]

    def ask(self, *submessages, stream=ids.STREAM_RELIABLE):
        """Send, and return the status values of the answers."""
        self.payloads(ids.STATUS)
        self.send(*submessages, stream=stream)
        return self.statuses()

    def samples(self):
        """Remove DATA from the inbox; return the samples without request and object id."""
        return [payload[4:] for payload in self.payloads(ids.DATA)]


def of(board):
    """Return the agent's ProxyClient of a board."""
    return board.desk.agent.clients[board.key]


def writer_of(board, object_id=WRITER):
    """Return the middleware's writer of a datawriter."""
    return of(board).objects[object_id].endpoint._writer
