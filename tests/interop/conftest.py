"""Fixtures of most tests with real rclpy: a DDS domain of the module's own, a peer, an agent.

A module that needs a different one overrides the fixture by name.
"""

import pytest
from conftest import leased_domain
from support.agent import running_agent
from support.middleware import MIDDLEWARE
from support.peer import RosPeer


@pytest.fixture(scope="module")
def domain():
    with leased_domain() as number:
        yield number


@pytest.fixture(scope="module")
def peer(ros_python, domain):
    """A real rclpy node in a process of its own."""
    with RosPeer(ros_python, domain) as running:
        yield running


@pytest.fixture(scope="module")
def agent(domain):
    """An agent in this process, for boards over UDP."""
    with running_agent("udp", MIDDLEWARE, domain) as running:
        yield running
