"""Services on auto while rclpy is being imported: a stand-in for it waits for an event.

The real one is for tests/interop.
"""

import select
import threading
import time

import pytest
from support.agent import running_agent
from support.client import XrceClient

from uros.middleware import auto, open_middleware
from uros.middleware.base import MiddlewareError, Service
from uros.middleware.ros2 import middleware as ros2
from uros.middleware.ros2 import rcl, types
from uros.middleware.services.pending_endpoints import PendingReplier, PendingRequester
from uros.qos import QoSProfile
from uros.wire import ids

SECONDS = 10.0
TYPES = "pkg::srv::dds_::Add_Request_", "pkg::srv::dds_::Add_Response_"
REQUEST = b"\0\1\0\0\5\0\0\0"
QOS = QoSProfile()


def service(name, kind="Add"):
    types = (part.replace("Add", kind) for part in TYPES)
    return Service(f"rq/{name}Request", next(types), f"rr/{name}Reply", next(types))


class Endpoint:
    """An endpoint on rclpy: records what is written, and returns ``samples``."""

    def __init__(self, network, topic):
        self.readers, self.writers, self.on_close = [], [], None
        self.written, self.samples, self.closed = [], [], False
        network.created.append((topic, self))

    def request(self, cdr):
        self.written.append(bytes(cdr))
        return len(self.written)

    def reply(self, guid, sequence, cdr):
        self.written.append((guid, sequence, bytes(cdr)))
        return True

    def take(self, limit):
        samples, self.samples = self.samples[:limit], self.samples[limit:]
        return samples

    def close(self):
        self.closed = True


class Network:
    """Stands for rclpy: the import ends when ``go`` is set; ``looked_up`` are requested types."""

    def __init__(self):
        self.go, self.begun = threading.Event(), threading.Event()
        self.looked_up, self.created, self.nodes = [], [], []
        self.failure = None
        self.missing = set()

    def prepare(self, *name):
        self.begun.set()
        assert self.go.wait(SECONDS)
        if self.failure is not None:
            raise self.failure

    def find_service(self, name):
        self.looked_up.append(name.name)
        if name.name in self.missing:
            raise types.UnknownType(f"{name}: package pkg has no such type")

    # --- Ros2Middleware and its nodes

    def create_node(self, domain, namespace, name, localhost_only):
        self.nodes.append(name)
        return self

    def create_requester(self, service, qos, on_ready):
        return Endpoint(self, service.request_topic)

    def create_replier(self, service, qos, on_ready):
        return Endpoint(self, service.reply_topic)

    def has_work(self):
        return False

    def dispatch(self):
        pass

    def close(self):
        self.go.set()


@pytest.fixture
def rclpy(monkeypatch):
    network = Network()
    monkeypatch.setattr(auto, "find_spec", lambda name: object())
    monkeypatch.setattr(types, "check_package", lambda name: None)
    monkeypatch.setattr(types, "find_service", network.find_service)
    monkeypatch.setattr(rcl, "prepare", network.prepare)
    monkeypatch.setattr(ros2, "Ros2Middleware", lambda wakeup: network)
    monkeypatch.delenv("RMW_IMPLEMENTATION", raising=False)
    yield network
    network.go.set()


@pytest.fixture
def middleware(rclpy):
    auto_middleware = open_middleware("auto")
    auto_middleware.batching = True
    auto_middleware.notices = []
    auto_middleware.on_notice = auto_middleware.notices.append
    yield auto_middleware
    rclpy.go.set()
    auto_middleware.close()


def until(middleware, done):
    deadline = time.monotonic() + SECONDS
    while not done():
        assert time.monotonic() < deadline, "it does not come"
        if select.select([middleware.fileno()], [], [], 0.1)[0]:
            middleware.dispatch()
        middleware.dispatch_local()


def test_other_boards_are_served_while_rclpy_is_imported(rclpy):
    with running_agent("udp", "auto") as agent:
        asking, beside = (XrceClient(agent.line(i), key=0x71000000 + i) for i in range(2))
        for client in (asking, beside):
            assert client.open() == ids.STATUS_OK
        caller = asking.service(ids.KIND_REQUESTER, "asking", "/add", *TYPES)
        asking.service(ids.KIND_REPLIER, "asking", "/serve", *TYPES)
        waiting = threading.Thread(target=asking.write, args=(caller, bytes(4)), daemon=True)
        waiting.start()
        assert rclpy.begun.wait(SECONDS)
        writer = beside.writer("beside", "rt/beside", "std_msgs::msg::dds_::Int32_")
        reader = beside.reader("beside", "rt/beside", "std_msgs::msg::dds_::Int32_")
        beside.read(reader)
        for number in range(50):
            beside.write(writer, number.to_bytes(4, "little"))
            assert beside.sample(reader)[:4] == number.to_bytes(4, "little")
        assert waiting.is_alive() and rclpy.created == []  # as long as the import takes
        rclpy.go.set()
        waiting.join(SECONDS)
        assert not waiting.is_alive()
        assert [topic for topic, _ in rclpy.created] == ["rq/addRequest", "rr/serveReply"]
        assert rclpy.created[0][1].written == [b"\0\1\0\0" + bytes(4)]
        for client in (asking, beside):
            client.close()
        assert all(end.closed for _, end in rclpy.created)


def test_pending_endpoints_have_no_room_and_are_created_one_per_turn(
    rclpy, middleware, own_domain_id
):
    node = middleware.create_node(own_domain_id, "/", "node")
    callers = [node.create_requester(service(f"add{i}"), QOS, lambda: None) for i in range(3)]
    server = node.create_replier(service("serve"), QOS, lambda: None)
    assert [caller.request(REQUEST) for caller in callers] == [None] * 3
    assert callers[0].take(9) == server.take(9) == []
    assert server.reply(bytes(16), 1, REQUEST)  # no client has sent a request
    rclpy.go.set()
    topics = []
    while len(topics) < 4:
        assert select.select([middleware.fileno()], [], [], SECONDS)[0]
        middleware.dispatch()
        assert len(rclpy.created) <= len(topics) + 1
        topics = [topic for topic, _ in rclpy.created]
    assert topics == ["rq/add0Request", "rq/add1Request", "rq/add2Request", "rr/serveReply"]
    assert rclpy.nodes == ["_node"] and rclpy.looked_up == ["Add"]
    assert [caller.request(REQUEST) for caller in callers] == [1, 1, 1]
    rclpy.created[0][1].samples = [(1, REQUEST)]
    rclpy.created[3][1].samples = [(bytes(16), 1, REQUEST)]
    assert callers[0].take(9) == [(1, REQUEST)]
    assert server.take(9) == [(bytes(16), 1, REQUEST)]
    assert server.reply(bytes(16), 1, REQUEST)
    assert rclpy.created[3][1].written == [(bytes(16), 1, REQUEST)]
    # Other endpoints of that type need not wait.
    assert isinstance(node.create_requester(service("more"), QOS, lambda: None), Endpoint)
    assert middleware.notices == []
    node.close()


def test_loaded_types_set_the_descriptor_that_dds_clears(
    rclpy, middleware, own_domain_id, monkeypatch
):
    """dispatch_local of DDS clears the descriptor after samples of this process."""
    monkeypatch.setattr(middleware.dds, "dispatch_local", middleware.dds.wakeup.clear)
    node = middleware.create_node(own_domain_id, "/", "node")
    node.create_requester(service("add"), QOS, lambda: None)
    rclpy.go.set()
    middleware._type_loader._thread.join(SECONDS)
    for _ in range(2):
        middleware.dispatch_local()
        assert select.select([middleware.fileno()], [], [], 0)[0]
    middleware.dispatch()
    assert len(rclpy.created) == 1


def test_a_pending_endpoint_that_is_closed_is_never_created(rclpy, middleware, own_domain_id):
    leaving, staying = (
        middleware.create_node(own_domain_id, "/", name) for name in ("leaving", "staying")
    )
    closed_requester = leaving.create_requester(service("left", "Sub"), QOS, lambda: None)
    closed = staying.create_requester(service("closed", "Mul"), QOS, lambda: None)
    open_requester = staying.create_requester(service("kept"), QOS, lambda: None)
    assert rclpy.begun.wait(SECONDS)
    leaving.close()
    closed.close()
    closed.close()
    rclpy.go.set()
    until(middleware, lambda: rclpy.created)
    assert [topic for topic, _ in rclpy.created] == ["rq/keptRequest"]
    assert "Mul" not in rclpy.looked_up  # no endpoint waited for the type any more
    assert closed_requester.request(REQUEST) is closed.request(REQUEST) is None
    open_requester.close()
    open_requester.close()
    assert rclpy.created[0][1].closed
    until(middleware, lambda: not middleware._loaded)
    assert not middleware._held


def test_creating_and_deleting_pending_endpoints_leaves_nothing(rclpy, middleware, own_domain_id):
    node = middleware.create_node(own_domain_id, "/", "node")
    for number in range(500):
        node.create_replier(service("x", f"T{number}"), QOS, lambda: None).close()
    assert len(middleware._type_loader._requested) <= 1
    assert not middleware._held and not node._pending
    rclpy.go.set()
    last_replier = node.create_replier(service("last"), QOS, lambda: None)
    until(middleware, lambda: rclpy.created)
    assert [topic for topic, _ in rclpy.created] == ["rr/lastReply"]
    assert len(rclpy.looked_up) <= 2
    last_replier.close()


def talk(middleware, node, name="add"):
    """Return whether a request is answered over DDS."""
    caller = node.create_requester(service(name), QOS, lambda: None)
    samples = []
    server = node.create_replier(service(name), QOS, lambda: samples.extend(server.take(9)))
    # A request before the server exists is lost, as with any middleware.
    until(middleware, lambda: caller.request(REQUEST) and samples)
    caller.close()
    server.close()
    return samples[0][2] == REQUEST


@pytest.mark.parametrize(
    "failure",
    [ImportError("no librcl.so"), MiddlewareError("no such RMW"), RuntimeError("odd"), OSError()],
)
def test_an_rclpy_that_does_not_start_leaves_services_to_dds_with_one_notice(
    rclpy, middleware, own_domain_id, failure
):
    rclpy.failure = failure
    node = middleware.create_node(own_domain_id, "/", "node")
    early = node.create_requester(service("early", "Sub"), QOS, lambda: None)
    rclpy.go.set()
    assert talk(middleware, node)
    assert early.request(REQUEST)
    assert not isinstance(node.create_replier(service("late"), QOS, lambda: None), PendingReplier)
    (notice,) = middleware.notices
    assert "rclpy cannot be used" in notice and str(failure) in notice
    assert rclpy.looked_up == []


def test_a_type_that_its_package_does_not_have_goes_over_dds(rclpy, middleware, own_domain_id):
    rclpy.missing.add("Add")
    rclpy.go.set()
    node = middleware.create_node(own_domain_id, "/", "node")
    for _ in range(2):
        assert talk(middleware, node)
    (notice,) = middleware.notices
    assert "rq/addRequest is there for rmw_cyclonedds only: pkg/srv/Add" in notice
    second_requester = node.create_requester(service("other", "Sub"), QOS, lambda: None)
    until(middleware, lambda: second_requester.request(REQUEST))
    assert [topic for topic, _ in rclpy.created] == ["rq/otherRequest"]


def test_a_refusal_of_dds_is_an_error_of_the_next_write(
    rclpy, middleware, own_domain_id, monkeypatch
):
    rclpy.missing.add("Add")
    node = middleware.create_node(own_domain_id, "/", "node")
    caller = node.create_requester(service("add"), QOS, lambda: None)
    server = node.create_replier(service("add"), QOS, lambda: None)

    def refuse(*_):
        raise MiddlewareError("no room in the domain")

    monkeypatch.setattr(node._dds, "create_requester", refuse)
    monkeypatch.setattr(node._dds, "create_replier", refuse)
    rclpy.go.set()
    until(middleware, lambda: len(middleware.notices) == 2 and not middleware._loaded)
    assert middleware.notices[1] == "service rq/addRequest is not there: no room in the domain"
    for write in (lambda: caller.request(REQUEST), lambda: server.reply(bytes(16), 1, REQUEST)):
        with pytest.raises(MiddlewareError, match="no room in the domain"):
            write()
    assert caller.take(9) == server.take(9) == []
    caller.close()
    server.close()


def test_a_refusal_of_dds_is_no_refusal_of_ros2(rclpy, middleware, own_domain_id, monkeypatch):
    monkeypatch.setattr(auto, "find_spec", lambda name: None)
    monkeypatch.setattr(ros2, "Ros2Middleware", lambda wakeup: exec("import rclpy.none"))
    node = middleware.create_node(own_domain_id, "/", "node")
    requests = []

    def refuse(*_):
        requests.append(1)
        raise MiddlewareError("no room in the domain")

    monkeypatch.setattr(node._dds, "create_requester", refuse)
    with pytest.raises(MiddlewareError, match="no room in the domain"):
        node.create_requester(service("add"), QOS, lambda: None)
    assert len(requests) == len(middleware.notices) == 1


@pytest.mark.parametrize(
    "wrong",
    [
        Service("rq/aRequest", *TYPES[:1], "rr/bReply", TYPES[1]),
        Service("plain", TYPES[0], "plainer", TYPES[1]),
        Service("rq/aRequest", "plain", "rr/aReply", TYPES[1]),
    ],
)
def test_types_that_ros2_cannot_carry_do_not_wait(rclpy, middleware, own_domain_id, wrong):
    node = middleware.create_node(own_domain_id, "/", "node")
    end = node.create_requester(wrong, QOS, lambda: None)
    assert not isinstance(end, PendingRequester) and end.request(REQUEST) == 1
    assert len(middleware.notices) == 1
    assert not rclpy.begun.is_set()


def test_a_host_program_waits(rclpy, middleware, own_domain_id):
    middleware.batching = False
    node = middleware.create_node(own_domain_id, "/", "node")
    assert isinstance(node.create_requester(service("add"), QOS, lambda: None), Endpoint)
    assert not rclpy.begun.is_set()


def test_closing_waits_for_the_thread_and_creates_nothing(rclpy, middleware, own_domain_id):
    node = middleware.create_node(own_domain_id, "/", "node")
    requester = node.create_requester(service("add"), QOS, lambda: None)
    node.create_requester(service("sub", "Sub"), QOS, lambda: None)
    assert rclpy.begun.wait(SECONDS)
    closing = threading.Thread(target=middleware.close)
    closing.start()
    closing.join(0.05)
    assert closing.is_alive()
    rclpy.go.set()
    closing.join(SECONDS)
    assert not closing.is_alive() and not middleware._type_loader._thread.is_alive()
    assert rclpy.created == [] and "Sub" not in rclpy.looked_up
    requester.close()
    node.close()
