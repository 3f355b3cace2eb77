"""New rules and admission while boards are connected: who leaves, who waits, who may connect."""

import socket

import pytest
from support.agent import running_agent
from support.client import XrceClient
from support.lines import SECONDS
from support.waiting import eventually
from unit.agent.helpers import Board, participant

from uros.agent.policy.admission import make_admission
from uros.agent.policy.replacement import replace_rules
from uros.agent.policy.rules import Rules
from uros.wire import ids


def rules_of(*tables):
    rules = Rules()
    for table in tables:
        rules.add(table)
    return rules


def test_clients_whose_rules_changed_wait_and_the_others_are_not_named(desk):
    for key in (1, 2, 3):
        Board(desk, peer=key, key=key).send(participant())
    before = rules_of({"key": 1, "domain": 3}, {"key": 2, "namespace": "/a"})
    replace_rules(desk.agent, [desk.place], before, make_admission())
    after = rules_of({"key": 1, "domain": 3}, {"key": 2, "namespace": "/b"})
    replaced = replace_rules(desk.agent, [desk.place], after, make_admission())
    assert (replaced.removed, replaced.waiting) == ([], [2])
    assert desk.agent.rules is after
    same = rules_of({"key": 1, "domain": 3}, {"key": 2, "namespace": "/b"})
    assert replace_rules(desk.agent, [desk.place], same, make_admission()).waiting == []


def test_clients_that_are_no_longer_admitted_are_deleted_and_a_smaller_number_deletes_none(desk):
    for key in (1, 2, 3):
        Board(desk, peer=key, key=key)
    admission = make_admission(keys=["1", "3"], max_clients=1)
    replaced = replace_rules(desk.agent, [desk.place], Rules(), admission)
    assert replaced.removed == [2] and list(desk.agent.clients) == [1, 3]


@pytest.fixture
def agent():
    with running_agent("tcp", "memory") as running:
        yield running


def replaced(agent, **admission):
    """Replace the admission in the thread of the server."""
    done = []
    agent.server.soon(
        lambda: done.append(
            replace_rules(
                agent.agent, agent.server.transports, Rules(), make_admission(**admission)
            )
        )
    )
    eventually(lambda: done)
    return done[0]


def test_networks_apply_to_new_tcp_connections_from_then_on_and_no_longer_once_removed(agent):
    client = XrceClient(agent.line(), 1)
    assert client.open() == ids.STATUS_OK
    assert replaced(agent, networks=["10.0.0.0/8"]).removed == [1]
    with socket.create_connection(("127.0.0.1", agent.transport.port), SECONDS) as sock:
        assert sock.recv(1) == b""  # closed at once
    assert replaced(agent).removed == []
    assert XrceClient(agent.line(), 2).open() == ids.STATUS_OK
