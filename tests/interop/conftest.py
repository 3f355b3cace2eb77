"""What most tests with real rclpy stand on: a domain of the module's own, a peer, an agent.

A module that needs another one of these has its own fixture of that name.
"""

import pytest
from conftest import leased_domain
from support.agent import running_agent
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
    """Ours, in this process, with boards by UDP."""
    with running_agent("udp", "dds", domain) as running:
        yield running
