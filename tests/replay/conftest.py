"""Fixtures of the vehicle tests: the ROS node and the agents; each module defines ``places``."""

import pytest
from conftest import leased_domain
from support.airfield import Ground


@pytest.fixture(scope="module")
def shared_ground():
    with leased_domain() as domain, Ground(domain) as node:
        yield node


@pytest.fixture
def ground(shared_ground):
    """The ROS node, without endpoints and samples of earlier tests."""
    yield shared_ground
    shared_ground.forget()


@pytest.fixture
def own_ground(own_domain_id):
    with Ground(own_domain_id) as node:
        yield node


@pytest.fixture
def place(places, transport, ground):
    """An agent in the domain of ``ground``."""
    yield places[transport]
    places[transport].land()
    ground.wait_for_empty_graph()
