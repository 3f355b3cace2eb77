"""Services of the dds middleware beside real nodes with rmw_fastrtps: in neither direction is a
request executed with wrong arguments, and the caller gets the reason."""

import re
import select
import struct
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from support.agent import running_agent
from support.client import XrceClient
from support.peer import RosPeer

import uros
from uros.client.action_client import ActionClient
from uros.host.direct import Direct
from uros.interfaces import load
from uros.middleware.base import MiddlewareError, Service
from uros.middleware.dds import cyclone, service_peers
from uros.middleware.dds.middleware import DdsMiddleware
from uros.qos import services_profile
from uros.wire import ids

TRIGGER = "std_srvs/srv/Trigger"
BASIC = "test_msgs/srv/BasicTypes"
REFUSED = "another form of services"
# Fixed fields, then a string. rmw_fastrtps would take the request header of 16 octets for the first
# fields, and the 1 for the length of the string: the request would be valid for it.
REQUEST = b"\0\1\0\0" + struct.pack(
    "<BBBxfdbBhHxxiIqQI", 1, 2, 3, 4.0, 5.0, 6, 7, 8, 9, 10, 11, 1, 0, 1
) + b"\0"  # fmt: skip
# Seconds in which no request may arrive; Fast DDS delivers one within milliseconds.
QUIET = 1.0
SECONDS = 20.0

pytestmark = pytest.mark.timeout(120)


@pytest.fixture(scope="module")
def peer(ros_python, domain):
    with RosPeer(ros_python, domain, Path(__file__).parent / "service_peer.py") as running:
        yield running


@pytest.fixture(scope="module")
def agent(domain):
    with running_agent("udp", "dds", domain) as running:
        yield running


@pytest.fixture
def middleware():
    opened = DdsMiddleware()
    yield opened
    opened.close()


@pytest.fixture
def node(middleware, domain):
    return middleware.create_node(domain, "/", "form")


def service(name, type_name):
    package, kind, plain = type_name.split("/")
    base = f"{package}::{kind}::dds_::{plain}"
    return Service(f"rq{name}Request", f"{base}_Request_", f"rr{name}Reply", f"{base}_Response_")


def until(middleware, done, seconds=SECONDS):
    deadline = time.monotonic() + seconds
    while not done():
        assert time.monotonic() < deadline, "the condition is not reached in time"
        if select.select([middleware.fileno()], [], [], 0.05)[0]:
            middleware.dispatch()
        middleware.dispatch_local()
        middleware.tick()


def test_a_request_is_refused_while_a_real_server_is_there(peer, middleware, node):
    peer.do("count", name="/refused", type=BASIC)
    requester = node.create_requester(service("/refused", BASIC), services_profile(), print)
    until(middleware, requester.refusal)
    with pytest.raises(MiddlewareError, match=REFUSED):
        requester.request(REQUEST)
    assert peer.do("counted", name="/refused", seconds=QUIET)["requests"] == []


@pytest.mark.parametrize("write", ["plain", "disposed"])
def test_a_request_before_discovery_is_not_executed(peer, middleware, node, monkeypatch, write):
    """Requests that are written as disposed samples do not reach a server of the other form.

    Written as plain data, as a comparison, they are executed with wrong arguments.
    """
    name = f"/late_{write}"
    peer.do("count", name=name, type=BASIC)
    if write == "plain":
        monkeypatch.setattr(cyclone, "write_disposed", cyclone.write)
    requester = node.create_requester(service(name, BASIC), services_profile(), print)
    until(middleware, requester.refusal)
    monkeypatch.setattr(service_peers.MatchedServers, "has_incompatible", lambda self: False)
    for _ in range(5):
        requester.request(REQUEST)
    seconds = SECONDS if write == "plain" else QUIET
    requests = peer.do("counted", name=name, seconds=seconds)["requests"]
    if write == "plain":
        sent = r"bool_value=True, byte_value=b'\\x02'"
        assert requests and not re.search(sent, requests[0]), requests
    else:
        assert requests == []


def test_a_real_clients_request_does_not_reach_our_server(peer, middleware, node):
    notices = []
    middleware.on_notice = notices.append
    replier = node.create_replier(service("/ours", TRIGGER), services_profile(), print)
    taken, answers = [], []

    def is_noticed():
        taken.extend(replier.take(10))
        return notices

    call = {"name": "/ours", "type": TRIGGER, "cdr": "0001000000"}
    calling = threading.Thread(target=lambda: answers.append(peer.do("call", **call, seconds=4)))
    calling.start()
    until(middleware, is_noticed)
    calling.join()
    assert taken == []
    assert "a client of /ours gets no answer" in notices[0]
    assert answers[0]["replies"] == []


def test_a_hosts_call_fails_with_the_reason(peer, domain):
    """A call fails whether the server is discovered before the call or after it."""
    trigger = load(TRIGGER)
    connection = uros.Node("caller", Direct(DdsMiddleware(), domain))
    client = connection.create_client(trigger, "/failing")
    early = client.call_async(trigger.Request())
    assert not early.done()
    peer.do("count", name="/failing", type=TRIGGER)
    deadline = time.monotonic() + SECONDS
    while not early.done() and time.monotonic() < deadline:
        connection.spin_once(0.05)
    late = client.call_async(trigger.Request())
    while not late.done() and time.monotonic() < deadline:
        connection.spin_once(0.05)
    for future in (early, late):
        assert REFUSED in str(future.exception())
    connection.destroy_node()
    assert peer.do("counted", name="/failing", seconds=QUIET)["requests"] == []


def test_uros_service_call_gives_the_reason(peer, domain):
    peer.do("count", name="/tool", type=TRIGGER)
    code = "import sys; from uros.tools.cli import main; sys.exit(main())"
    command = [sys.executable, "-c", code, "service", "call", "/tool", "-m", "dds"]
    done = subprocess.run(
        [*command, "--domain", str(domain)], capture_output=True, text=True, timeout=SECONDS
    )
    assert done.returncode == 1 and REFUSED in done.stderr, done.stderr
    assert peer.do("counted", name="/tool", seconds=QUIET)["requests"] == []


def test_a_boards_call_gets_a_status_and_the_log_the_reason(peer, agent):
    peer.do("count", name="/board", type=BASIC)
    board = XrceClient(agent.line(0), key=0x62000001)
    assert board.open() == ids.STATUS_OK
    types = service("/board", BASIC)
    requester = board.service(
        ids.KIND_REQUESTER, "caller", "/board", types.request_type, types.reply_type
    )
    board.read(requester)
    # If the server is not discovered before the first request, the STATUS comes when it is.
    for _ in range(2):
        request = board.write(requester, REQUEST[4:])
        board.until(lambda key=(request, requester): key in board.statuses, "no STATUS", SECONDS)
        assert board.statuses[request, requester] == ids.STATUS_ERR_DDS_ERROR
    assert REFUSED in agent.said.getvalue()
    assert peer.do("counted", name="/board", seconds=QUIET)["requests"] == []
    board.close()


def test_a_goal_for_a_real_action_server_fails_and_is_not_executed(ros_python, domain):
    fibonacci = load("test_msgs/action/Fibonacci")
    with RosPeer(ros_python, domain, Path(__file__).parent / "action_peer.py") as server:
        server.do("serve", name="/form/fibonacci")
        node = uros.Node("goals", Direct(DdsMiddleware(), domain))
        client = ActionClient(node, fibonacci, "/form/fibonacci")
        futures = [client.send_goal_async(fibonacci.Goal(3))]
        deadline = time.monotonic() + SECONDS
        while not futures[-1].done() and time.monotonic() < deadline:
            node.spin_once(0.05)
        futures.append(client.send_goal_async(fibonacci.Goal(3)))
        while not futures[-1].done() and time.monotonic() < deadline:
            node.spin_once(0.05)
        for future in futures:
            assert REFUSED in str(future.exception())
        node.destroy_node()
        assert server.do("stop")["orders"] == []
