"""Boards on an agent with RTPS in Python, and a real rclpy node: no DDS library is in the agent.

The tests are those of the dds and ros2 middlewares, on the rtps middleware.
"""

import sys

import pytest
from interop import test_ros2_middleware
from interop.test_agent import (  # noqa: F401  pytest collects them here
    test_a_board_that_closes_its_session_leaves_the_graph,
    test_a_boards_node_is_in_the_graph_with_its_publishers_until_it_leaves,
    test_a_fragmented_image_of_a_board_arrives_intact,
    test_a_late_subscriber_gets_a_boards_transient_local_samples,
    test_each_boards_node_has_only_its_own_publishers,
    test_endpoints_announce_type_hash_and_qos,
    test_int32_of_a_board_arrives,
    test_ros_messages_reach_a_clients_reader,
    test_temperature_and_humidity_of_a_board_arrive,
)
from support.agent import running_agent
from support.peer import RosPeer

pytestmark = pytest.mark.timeout(180)


@pytest.fixture(scope="module")
def agent(domain):
    with running_agent("udp", "rtps", domain) as running:
        yield running


@pytest.fixture(scope="module")
def service_agent(domain):
    """An agent in a process of its own, whose Python has no rclpy."""
    with test_ros2_middleware.running(sys.executable, domain, "rtps") as running:
        yield running


@pytest.fixture(scope="module")
def service_peer(ros_python, domain):
    with RosPeer(ros_python, domain, test_ros2_middleware.HERE / "service_peer.py") as running:
        yield running


@pytest.mark.parametrize(
    "test",
    [
        test_ros2_middleware.test_a_real_node_calls_a_boards_service_many_times,
        test_ros2_middleware.test_a_board_calls_a_real_nodes_service_many_times,
        test_ros2_middleware.test_a_service_may_answer_late,
        test_ros2_middleware.test_two_boards_may_offer_a_service_of_the_same_name,
    ],
    ids=lambda test: test.__name__.removeprefix("test_"),
)
def test_services_with_rmw_fastrtps_need_no_rclpy(service_agent, service_peer, test):
    test(service_agent, service_peer)


def test_no_dds_library_is_loaded(service_agent):
    """Neither Cyclone's nor Fast DDS's."""
    pid = service_agent._process.pid
    with open(f"/proc/{pid}/maps", encoding="utf-8") as file:
        maps = file.read()
    assert "cyclonedds" not in maps and "fastdds" not in maps and "rclpy" not in maps
