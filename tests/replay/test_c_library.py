"""Compares support/autopilot.py, the base of PX4 and ArduPilot, with eProsima's C library.

The module takes the client's place in the captures; it must send the same bytes.
"""

import os
import tty

from support import autopilot
from support.autopilot import (
    BY_XML,
    PARTICIPANT,
    PUBLISHER,
    READER,
    REPLIER,
    SUBSCRIBER,
    TOPIC,
    WRITER,
    object_id,
)
from support.replay import load


class RecordingLink:
    """A link without an agent, which records the messages sent."""

    def __init__(self):
        self.sent = []

    def fileno(self):
        raise AssertionError("nothing waits for it")

    def send(self, message):
        self.sent.append(bytes(message))

    def read(self):
        return []


# Uninitialized padding of the library, and zeros in its place.
GARBAGE = {
    bytes.fromhex("00c9a05e26"): bytes.fromhex("0000000026"),
    bytes.fromhex("030001160a00"): bytes.fromhex("030001000a00"),
    bytes.fromhex("030001320a00"): bytes.fromhex("030001000a00"),
}


def play(name, *steps, key=0xAAAABBBB, mode=autopilot.REPLACE, client=0):
    """Run steps with the recorded answers, and compare the messages sent; the session.

    Each step makes the calls that sent the client's next messages in the capture, after the answers
    that the agent had sent by then.
    """
    link = RecordingLink()
    session = autopilot.Session(link, key, 4)
    session.mode = mode
    steps = list(steps)
    theirs = []
    for record in load(name):
        if record.client != client:
            continue
        if not record.from_client:
            session.take(record.data)
            continue
        theirs.append(record.data)
        sent = [message for message in link.sent if not is_acknowledgement(message)]
        if steps and len(sent) < sum(not is_acknowledgement(message) for message in theirs):
            steps.pop(0)(session)
            session.flush()
    assert not steps
    sent = [message for message in link.sent if not is_acknowledgement(message)]
    for own, recorded in zip(
        sent, [message for message in theirs if not is_acknowledgement(message)], strict=False
    ):
        for garbage, zeros in GARBAGE.items():
            recorded = recorded.replace(garbage, zeros)
        # Some messages have padding after the last submessage.
        assert recorded.startswith(own) and len(recorded) - len(own) < 4, (
            own.hex(),
            recorded.hex(),
        )
        assert not any(recorded[len(own) :])
    acknowledgements = [message for message in link.sent if message[4] == autopilot.ACKNACK]
    assert set(acknowledgements) <= set(theirs)
    return session


def is_acknowledgement(message):
    return message[4] in (autopilot.ACKNACK, autopilot.HEARTBEAT)


CREATE_CLIENT = autopilot.Session.create_client
ONE = {kind: object_id(1, kind) for kind in range(1, 9)}


def test_entities_in_binary_are_what_the_c_library_writes():
    def entities(session):
        session.participant_bin(1, 0, None)
        session.topic_bin(1, ONE[PARTICIPANT], "ExampleTopic", "ExampleType")
        session.group_bin(1, PUBLISHER, ONE[PARTICIPANT])
        session.endpoint_bin(1, WRITER, ONE[PUBLISHER], ONE[TOPIC], 0x0B, 0)
        session.group_bin(1, SUBSCRIBER, ONE[PARTICIPANT])
        session.endpoint_bin(1, READER, ONE[SUBSCRIBER], ONE[TOPIC], 0x0B, 0)

    def read_and_write(session):
        session.read_data(ONE[READER], 0x80)
        session.write_reliable(ONE[WRITER], bytes(4))

    def write(session):
        session.write_reliable(ONE[WRITER], bytes((1, 0, 0, 0)))

    session = play("binary_entities", CREATE_CLIENT, entities, read_and_write, write)
    assert list(session.samples[ONE[READER]])[:2] == [bytes(4), bytes((1, 0, 0, 0))]
    assert [session.statuses[request] for request in range(10, 16)] == [autopilot.OK] * 6


def test_a_named_participant_and_a_depth_are_what_the_c_library_writes():
    session = play(
        "rclc_int32_publisher",
        CREATE_CLIENT,
        lambda session: session.participant_bin(0, 0, "int32_pub_node"),
        lambda session: session.topic_bin(
            0, object_id(0, PARTICIPANT), "rt/std_msgs_msg_Int32", "std_msgs::msg::dds_::Int32_"
        ),
        lambda session: session.group_bin(0, PUBLISHER, object_id(0, PARTICIPANT)),
        lambda session: session.endpoint_bin(
            0, WRITER, object_id(0, PUBLISHER), object_id(0, TOPIC), 0x03, 10
        ),
        lambda session: session.write_reliable(object_id(0, WRITER), bytes(4)),
        key=0x4B0CBE99,
        mode=autopilot.REUSE | autopilot.REPLACE,
    )
    assert session.statuses[13] == autopilot.OK


def test_a_service_is_what_the_c_library_writes():
    def answer(session):
        (request,) = session.samples[object_id(0, REPLIER)]
        body = bytes((1, 0, 0, 0)) + autopilot.string("triggered 1")
        session.write_reliable(object_id(0, REPLIER), request[:24] + body)

    play(
        "rclc_trigger",
        CREATE_CLIENT,
        lambda session: session.participant_bin(0, 0, "trigger_server_node"),
        lambda session: session.replier_bin(
            0,
            object_id(0, PARTICIPANT),
            "/trigger",
            [f"std_srvs::srv::dds_::Trigger_{suffix}_" for suffix in ("Request", "Response")],
            ["rq/triggerRequest", "rr/triggerReply"],
        ),
        lambda session: session.read_data(object_id(0, REPLIER), 0x80),
        answer,
        key=0x11,
        mode=autopilot.REUSE | autopilot.REPLACE,
    )


def test_xml_best_effort_and_delete_are_what_the_c_library_writes():
    topic = "<name>HelloWorldTopic</name><dataType>HelloWorld</dataType>"

    def entities(session):
        name = "<rtps><name>default_xrce_participant</name></rtps>"
        xml = f"<dds><participant>{name}</participant></dds>"
        session.create(1, PARTICIPANT, BY_XML, xml, 0)
        xml = f"<dds><topic>{topic}</topic></dds>"
        session.create(1, TOPIC, BY_XML, xml, ONE[PARTICIPANT])
        session.create(1, PUBLISHER, BY_XML, "", ONE[PARTICIPANT])
        xml = f"<dds><data_writer><topic><kind>NO_KEY</kind>{topic}</topic></data_writer></dds>"
        session.create(1, WRITER, BY_XML, xml, ONE[PUBLISHER])

    def write(session):
        for number in range(1, 4):
            text = autopilot.string("Hello DDS world!")
            session.write_best_effort(ONE[WRITER], number.to_bytes(4, "little") + text)
        session.delete_client()

    play("publish_best_effort", CREATE_CLIENT, entities, write)


def test_fragments_are_what_the_c_library_writes():
    session = autopilot.Session(RecordingLink(), 1, 40)
    session.write_reliable(object_id(0, WRITER), published("rclc_image")[0])
    session.flush()
    recorded_parts = [
        record.data
        for record in load("rclc_image")
        if record.from_client and record.data[4] == autopilot.FRAGMENT
    ][: len(session.link.sent)]
    assert len(recorded_parts) > 25
    for own, recorded in zip(session.link.sent, recorded_parts, strict=True):
        # The sequence numbers and the request ids differ.
        assert own[4:8] == recorded[4:8] and own[14:] == recorded[14 : len(own)]


def published(name):
    """The samples of a capture's client, reassembled from fragments."""
    out, whole = [], b""
    for record in load(name):
        if record.from_client and record.data[4] == autopilot.FRAGMENT:
            size = record.data[6] | record.data[7] << 8
            whole += record.data[8 : 8 + size]
            if record.data[5] & autopilot.LAST_FRAGMENT:
                out.append(whole[8:])
                whole = b""
    return out


def test_pings_are_what_the_c_library_writes():
    session = play(
        "ping",
        autopilot.Session.ping,
        CREATE_CLIENT,
        lambda session: session.ping(autopilot.SESSION_ID),
    )
    assert [session.pong(), session.pong()] == [2, 1]


def test_the_time_is_asked_for_as_by_the_c_library():
    requests = [
        record.data for record in load("time_sync") if record.from_client and record.data[4] == 14
    ]
    steps = [
        lambda session, raw=raw: session.ask_time(
            int.from_bytes(raw[8:12], "little"), int.from_bytes(raw[12:], "little")
        )
        for raw in requests
    ]
    session = play("time_sync", CREATE_CLIENT, *steps, key=0xCCCCDDDD)
    assert len(session.times) == len(requests) > 5


def test_frames_are_those_of_the_c_library():
    ends = os.openpty()
    link = autopilot.SerialLink(ends[0])
    tty.setraw(ends[1])
    try:
        for name in ("serial_ping", "serial_publish"):
            for record in load(name):
                if not record.from_client:
                    os.write(ends[1], record.data)
                    messages = link.read()
                    assert messages and all(message[0] in (0x80, 0x81) for message in messages)
                    assert (
                        b"".join(autopilot.framed(message, 0, 1) for message in messages)
                        == record.data
                    )
                    continue
                frames = [frame for frame in record.data.split(b"\x7e") if frame]
                for raw in frames:
                    octets = autopilot.unstuffed(raw)
                    assert autopilot.framed(octets[4:-2]) == b"\x7e" + raw
    finally:
        for fd in ends:
            os.close(fd)
