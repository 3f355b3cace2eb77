import pytest
from unit.agent.helpers import Board, Desk


@pytest.fixture
def desk():
    made = Desk()
    yield made
    made.close()
    assert not made.middleware.bus.nodes
    assert not any(made.middleware.bus.writers.values())
    assert not any(made.middleware.bus.readers.values())


@pytest.fixture
def board(desk):
    return Board(desk)
