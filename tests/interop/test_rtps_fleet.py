"""Many nodes on one participant of rtps, and a real rclpy node that starts after them."""

import select
import threading
import time

import pytest
from support.peer import RosPeer

from uros.middleware.base import Service
from uros.middleware.rtps.middleware import RtpsMiddleware
from uros.qos import QoSProfile

pytestmark = pytest.mark.timeout(180)

BOARDS = 1000
STRING = "std_msgs::msg::dds_::String_"


def create_board(middleware, domain, number):
    node = middleware.create_node(domain, "/", f"board_{number}")
    for topic in ("a", "b"):
        node.create_writer(f"rt/board_{number}/{topic}", STRING, QoSProfile())
    node.create_reader(f"rt/board_{number}/c", STRING, QoSProfile(), lambda: None)
    service = Service(
        f"rq/board_{number}/sRequest", "std_srvs::srv::dds_::Trigger_Request_",
        f"rr/board_{number}/sReply", "std_srvs::srv::dds_::Trigger_Response_",
    )  # fmt: skip
    node.create_replier(service, QoSProfile(), lambda: None)


@pytest.fixture
def fleet(domain):
    """A middleware with a thousand nodes, each with five endpoints, and its data plane."""
    middleware = RtpsMiddleware()
    for number in range(BOARDS):
        create_board(middleware, domain, number)
    end = threading.Event()

    def work():
        while not end.is_set():
            deadline = middleware.next_deadline()
            left = 0.1 if deadline is None else deadline - time.monotonic()
            if select.select([middleware.fileno()], [], [], max(0.0, min(0.1, left)))[0]:
                middleware.dispatch()
            middleware.tick()

    thread = threading.Thread(target=work)
    thread.start()
    yield middleware
    end.set()
    thread.join()
    middleware.close()


def test_a_late_rclpy_sees_all_of_a_thousand_nodes_and_their_endpoints(fleet, ros_python, domain):
    with RosPeer(ros_python, domain) as peer:
        for number in range(0, BOARDS, 111):
            answer = peer.do(
                "node", namespace="/", name=f"board_{number}",
                publishers={f"/board_{number}/{topic}": "std_msgs/msg/String" for topic in "ab"},
            )  # fmt: skip
            assert answer["publishers"], (len(answer["names"]), number)
            subscriptions = peer.do("topic", topic=f"/board_{number}/c", of="subscriptions")
            assert len(subscriptions["infos"]) == 1
        assert {f"board_{number}" for number in range(BOARDS)} <= set(answer["names"])
