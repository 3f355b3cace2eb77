import pytest
from unit.agent.helpers import Board, Desk


@pytest.fixture
def desk():
    desk = Desk()
    yield desk
    desk.close()
    assert not desk.middleware.bus.nodes
    assert not any(desk.middleware.bus.writers.values())
    assert not any(desk.middleware.bus.readers.values())


@pytest.fixture
def board(desk):
    return Board(desk)
