"""What tests of a transport share, whose module has an ``agent`` on it."""

import socket

import pytest
from support.lines import SECONDS
from unit.agent.transports.faults import Bystanders


@pytest.fixture(scope="module")
def bystanders(agent):
    return Bystanders(agent)


@pytest.fixture
def raw(agent, bystanders):
    """A bare connection of our own; the others still go on when we are through with it."""
    with socket.create_connection(("127.0.0.1", agent.transport.port), SECONDS) as sock:
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        yield sock
    bystanders.check()
