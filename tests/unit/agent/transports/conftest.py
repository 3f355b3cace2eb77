"""Fixtures for the modules of transports that define ``agent``."""

import socket

import pytest
from support.lines import SECONDS
from unit.agent.transports.faults import Bystanders


@pytest.fixture(scope="module")
def bystanders(agent):
    return Bystanders(agent)


@pytest.fixture
def raw(agent, bystanders):
    """Yield a raw TCP connection; other clients must be served after it."""
    with socket.create_connection(("127.0.0.1", agent.transport.port), SECONDS) as sock:
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        yield sock
    bystanders.check()
