"""The recorded board with the agent of uros over UDP."""

import pytest
from support.agent import running_agent
from support.client import XrceClient
from support.lines import SECONDS
from support.middleware import MIDDLEWARE
from support.recorded import RecordedBoard, UdpBoard
from support.replay import load

TEMPERATURE = "sensor_msgs::msg::dds_::Temperature_"


def address(agent):
    return "127.0.0.1", agent.transport.port


@pytest.fixture
def agent(own_domain_id):
    with running_agent("udp", MIDDLEWARE, own_domain_id) as running:
        yield running


def test_an_endless_board_repeats_its_samples_and_closes_its_session(agent):
    records = load("rclc_temperature_humidity")
    listener = XrceClient(agent.line(), key=0x99)
    listener.open()
    reader = listener.reader("listener", "rt/garden/temperature", TEMPERATURE)
    listener.read(reader)
    with UdpBoard(RecordedBoard(records, endless=True), address(agent)) as board:
        samples = [listener.sample(reader) for _ in range(8)]  # five were recorded
        assert samples[5:] == samples[:3]
        assert board.board.published >= 15
        assert len(agent.agent.clients) == 2
    listener.ping()  # after the board's DELETE of the session
    assert len(agent.agent.clients) == 1
    assert "session closed" in agent.said.getvalue()


def test_a_board_that_is_not_endless_ends_by_itself(agent):
    with UdpBoard(RecordedBoard(load("publish_reliable")), address(agent)) as board:
        assert board.join(SECONDS)
        assert board.board.done and board.board.published == 3
    assert agent.agent.clients == {}


def test_a_board_without_an_agent_can_be_stopped():
    board = UdpBoard(RecordedBoard(load("rclc_int32_publisher"), endless=True), ("127.0.0.1", 9))
    board.start()
    board.stop()
    board.stop()


def test_a_board_that_never_started_can_be_stopped():
    UdpBoard(RecordedBoard(load("rclc_int32_publisher")), ("127.0.0.1", 9)).stop()
