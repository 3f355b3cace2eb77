"""Eviction: which clients are deleted for a new one, by address and socket."""

import time

import pytest
from hypothesis import given
from hypothesis import strategies as st
from unit.agent.helpers import (
    OK,
    RESOURCES,
    Desk,
    Place,
    create_client,
    message,
    parse,
    participant,
    publisher_entities,
)

from uros.agent.policy import eviction as module
from uros.agent.policy.admission import MAX_CLIENTS, make_admission
from uros.agent.policy.eviction import EvictionPolicy, network_of


class Addresses(Place):
    """Peers are (host, port), as of UDP."""

    def host_of(self, peer):
        return peer[0]

    def address(self, peer):
        return f"{peer[0]}:{peer[1]}"


def a_desk(most=MAX_CLIENTS, place=Addresses):
    desk = Desk(admission=make_admission(max_clients=most))
    desk.agent.log.level = 3  # thousands of clients come
    desk.place = place()
    return desk


def status(sent):
    (found,) = [it for _, datagram in sent for it in parse(datagram)[1] if it[0] == 4]
    return found[2][0]


def come(desk, key, peer, things=1, session_id=0x05):
    """A client comes and makes something; the status of its CREATE_CLIENT."""
    got = status(desk.hear(create_client(key, session_id), peer))
    if got == OK and things:
        made = [participant(), *publisher_entities()[1:]][:things]
        desk.hear(message(made, 0x80, 0, session_id, key), peer)
        assert len(desk.agent.clients[key].objects) == things
    return got


ATTACKER = ("192.0.2.66", 666)
BOARD = ("192.0.2.7", 2018)


# --- the places ---------------------------------------------------------------------------------


ONE = MAX_CLIENTS - MAX_CLIENTS // 16  # what one network may have


def fill(desk, peer_of, count=MAX_CLIENTS, **more):
    """So many come within two seconds, and as many as may get in."""
    for key in range(1000, 1000 + count):
        come(desk, key, peer_of(key), **more)
        desk.clock += key % 3 == 0
    assert len(desk.agent.clients) >= ONE


@pytest.mark.parametrize("host", ["192.0.2.7", ATTACKER[0]])
def test_one_socket_that_took_all_places_loses_them_at_once(host):
    """4,096 sessions, each with an object, from one UDP socket in two seconds."""
    desk = a_desk()
    early = [(key, ("192.0.2.8", key)) for key in range(1, 11)]
    for key, peer in early:
        assert come(desk, key, peer) == OK
    fill(desk, lambda key: ATTACKER)
    for number in range(300):
        assert come(desk, 1_000_000 + number, (host, number)) == OK
        desk.clock += 1
    assert all(key in desk.agent.clients for key, _ in early)
    assert all(1_000_000 + it in desk.agent.clients for it in range(300))
    assert len(desk.agent.clients) <= MAX_CLIENTS
    assert "one socket has most of the sessions" in desk.log()
    desk.close()


def test_nor_does_it_help_that_its_sessions_talk_all_the_time():
    desk = a_desk()
    fill(desk, lambda key: ATTACKER)
    desk.clock += 10_000
    for client in desk.agent.clients.values():
        client.session.heard = desk.clock
    assert come(desk, 1, BOARD) == OK
    assert come(desk, 2, (ATTACKER[0], 1)) == OK
    desk.close()


@pytest.mark.parametrize(
    "host", [lambda key: "192.0.2.66", lambda key: f"2001:db8::{key:x}"], ids=["IPv4", "IPv6 /64"]
)
@pytest.mark.parametrize("newcomer", ["192.0.2.7", "2001:db8:0:1::7", "the same"])
def test_many_sockets_of_one_address_lose_their_places_when_they_are_silent(host, newcomer):
    desk = a_desk()
    fill(desk, lambda key: (host(key), key))
    board = host(1) if newcomer == "the same" else newcomer, 1
    if newcomer == "the same":
        assert come(desk, 1, board) == RESOURCES  # they might be boards that begin
        desk.clock += module.SILENT_MS
    assert come(desk, 1, board) == OK  # the others have places reserved for them
    for number in range(2, 600):
        desk.clock += module.SILENT_MS // 10
        desk.agent.clients[1].session.heard = desk.clock
        assert come(desk, number, (board[0], 10_000 + number)) == OK
    assert 1 in desk.agent.clients
    desk.close()


def test_one_address_cannot_have_all_places_however_lively_it_is():
    desk = a_desk()
    fill(desk, lambda key: ("192.0.2.66", key))
    assert come(desk, 1, ("192.0.2.66", 1)) == RESOURCES
    assert len(desk.agent.clients) == ONE
    for number in range(100, 250):
        assert come(desk, number, (f"192.0.2.{number}", 1)) == OK
    desk.close()


def test_a_board_that_works_does_not_leave_for_anybody():
    desk = a_desk(100)
    for number in range(100):
        assert come(desk, 1 + number, (f"192.0.2.{number}", 1)) == OK
    desk.clock += 60_000  # silent subscribers
    for number in range(50):
        assert come(desk, 5000 + number, (f"198.51.100.{number}", 1)) == RESOURCES
    assert set(desk.agent.clients) == set(range(1, 101))
    desk.close()


def test_where_the_owner_has_few_places_they_are_not_fought_for():
    """Twenty silent boards behind one address, and a twenty-first."""
    desk = a_desk(20)
    for number in range(20):
        assert come(desk, 1 + number, ("192.0.2.9", number)) == OK
    desk.clock += 60_000
    assert come(desk, 99, ("192.0.2.9", 99)) == RESOURCES
    assert set(desk.agent.clients) == set(range(1, 21))
    desk.close()


def test_the_cheapest_and_the_youngest_go_first():
    desk = a_desk(64)
    rich = range(1, 11)
    for key in rich:
        assert come(desk, key, ATTACKER, things=4) == OK
    for key in range(11, 65):
        assert come(desk, key, ATTACKER) == OK
    before = set(desk.agent.clients)
    assert come(desk, 1000, BOARD) == OK
    assert before - set(desk.agent.clients) == {61, 62, 63, 64}  # a sixteenth, the last that came
    assert come(desk, 1001, ("192.0.2.9", 1)) == OK
    assert set(rich) <= set(desk.agent.clients)
    desk.close()


@pytest.mark.parametrize("what", ["line", "bus"])
def test_one_board_of_a_line_or_a_bus_does_not_take_the_places_of_the_network(what):
    """Serial lines and CAN: a network is a transport, a socket is a number on it."""
    desk = a_desk(64)
    network = desk.place
    desk.place = line = Place()
    for key in range(1, 65):
        assert come(desk, key, 1 if what == "line" else key) == OK
    desk.place = network
    if what == "bus":
        desk.clock += module.SILENT_MS
    assert come(desk, 1000, BOARD) == OK
    assert desk.agent.place(1000)[0] is network and line is not network
    desk.close()


def test_a_flood_in_vain_costs_a_look_ten_times_a_second(monkeypatch):
    desk = a_desk()
    fill(desk, lambda key: ("192.0.2.66", key))
    looks = []
    silent = EvictionPolicy._silent
    monkeypatch.setattr(EvictionPolicy, "_silent", lambda *them: looks.append(1) or silent(*them))
    for number in range(1000):
        assert come(desk, 1_000_000 + number, ("192.0.2.66", 10_000 + number)) == RESOURCES
        desk.clock += 1
    assert len(looks) <= 11
    desk.close()


def test_a_flood_over_the_limit_is_served_in_time():
    """Each newcomer of a flood, and those who leave for it, cost less than a millisecond."""
    desk = a_desk()
    fill(desk, lambda key: ATTACKER, things=0)
    before = time.process_time()
    for key in range(10_000, 14_096):
        desk.hear(create_client(key, 0x05), ATTACKER)
    assert time.process_time() - before < 12.0
    desk.close()


# --- the counts ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "one, other, same",
    [
        ("192.0.2.1", "192.0.2.1", True),
        ("192.0.2.1", "192.0.2.2", False),
        ("2001:db8::1", "2001:db8::ffff:1", True),
        ("2001:db8:0:1::1", "2001:db8:0:2::1", False),
        ("fe80::1%eth0", "fe80::2%eth1", True),
        ("::ffff:192.0.2.1", "192.0.2.1", True),
    ],
)
def test_what_a_network_is(one, other, same):
    place = Addresses()
    assert (network_of(place, (one, 1)) == network_of(place, (other, 2))) == same


def test_a_line_is_a_network_of_its_own():
    first, second = Place(), Place()
    assert network_of(first, 1) == network_of(first, 2) != network_of(second, 1)


@given(
    st.lists(
        st.tuples(st.sampled_from("cdw"), st.integers(1, 30), st.integers(0, 2), st.integers(0, 4)),
        max_size=120,
    )
)
def test_the_counts_are_those_of_the_clients_whatever_comes(steps):
    desk = a_desk(20)
    for what, key, host, port in steps:
        if what == "c":
            desk.hear(create_client(key, 0x05 if port else 0x81), (f"192.0.2.{host}", port))
        elif what == "d":
            desk.agent.delete_client(key)
        else:
            desk.wait(250 * key)
    counted = {
        client.key: (transport, peer)
        for sockets in desk.agent.eviction._networks.values()
        for (transport, peer), clients in sockets.items()
        for client in clients
    }
    assert counted == desk.agent._places
    assert sum(desk.agent.eviction._counts.values()) == len(desk.agent.clients) <= 20
    desk.close()
    assert not desk.agent.eviction._networks and not desk.agent.eviction._counts
