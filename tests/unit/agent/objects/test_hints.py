"""Advice in the log for C clients whose buffers are too small."""

import pytest
from support.agent import running_agent
from support.client import XrceClient

from uros.wire import entities, ids

TYPE = "std_msgs::msg::dds_::UInt8MultiArray_"


@pytest.fixture
def agent():
    with running_agent("udp", "memory", None) as running:
        yield running


@pytest.fixture
def client(agent):
    client = XrceClient(agent.line(), 0x11, mtu=512)
    assert client.open() == ids.STATUS_OK
    return client


def create(client, *about):
    return client.request(ids.CREATE, entities.push_create, *about)


def test_a_message_of_many_fragments_is_logged_once(agent, client):
    writer, reader = client.writer("n", "rt/a", TYPE), client.reader("n", "rt/a", TYPE)
    client.read(reader)
    for size in (4 * 500 - 8, 4 * 504, 3000):  # 504 bytes a fragment, 8 of them the headers
        client.write(writer, bytes(size))
        assert client.sample(reader) == bytes(size)
        if size == 4 * 500 - 8:
            assert "large message" not in agent.said.getvalue()
    log = agent.said.getvalue()
    assert log.count("large message") == 1
    assert "in 5 fragments" in log and "RMW_UXRCE_STREAM_HISTORY" in log


@pytest.mark.parametrize(
    "form, content",
    [
        (ids.IN_BINARY, b"\x01\0\0\0\x50\0\0\0/namespace/that/is/cu"),
        (ids.AS_XML, "<dds><participant><rtps><name>cut</na"),
    ],
)
def test_a_truncated_representation_is_logged_with_advice(agent, client, form, content):
    status = create(client, 0x11, form, content, 0)
    assert status == ids.STATUS_ERR_INVALID_DATA
    assert "RMW_UXRCE_REF_BUFFER_LENGTH" in agent.said.getvalue()


def test_a_representation_that_is_wrong_but_whole_gets_no_such_advice(agent, client):
    status = create(client, 0x12, ids.AS_XML, "<dds></dds>", 0x11)
    assert status == ids.STATUS_ERR_INVALID_DATA
    assert "REF_BUFFER" not in agent.said.getvalue()
