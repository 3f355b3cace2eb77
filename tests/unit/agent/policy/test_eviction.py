"""Eviction: which clients are deleted for a new one, by address and socket."""

import time

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.variants import slow_except
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
    """A transport whose peers are (host, port), as of UDP."""

    def host_of(self, peer):
        return peer[0]

    def address(self, peer):
        return f"{peer[0]}:{peer[1]}"


def a_desk(most=MAX_CLIENTS, place=Addresses):
    desk = Desk(admission=make_admission(max_clients=most))
    desk.agent.log.level = 3  # thousands of clients connect
    desk.place = place()
    return desk


def status(sent):
    (status_message,) = [
        submessage
        for _, datagram in sent
        for submessage in parse(datagram)[1]
        if submessage[0] == 4
    ]
    return status_message[2][0]


def come(desk, key, peer, objects=1, session_id=0x05):
    """Connect a client that creates objects; return the status of its CREATE_CLIENT."""
    client_status = status(desk.hear(create_client(key, session_id), peer))
    if client_status == OK and objects:
        submessages = [participant(), *publisher_entities()[1:]][:objects]
        desk.hear(message(submessages, 0x80, 0, session_id, key), peer)
        assert len(desk.agent.clients[key].objects) == objects
    return client_status


ATTACKER = ("192.0.2.66", 666)
BOARD = ("192.0.2.7", 2018)


# --- the places ---------------------------------------------------------------------------------


ONE = MAX_CLIENTS - MAX_CLIENTS // 16  # the most clients of one network


def fill(desk, peer_of, count=MAX_CLIENTS, **more):
    """Connect so many clients within two seconds; as many as allowed are admitted."""
    for key in range(1000, 1000 + count):
        come(desk, key, peer_of(key), **more)
        desk.clock += key % 3 == 0
    assert len(desk.agent.clients) >= ONE


@pytest.mark.parametrize("host", slow_except(["192.0.2.7", ATTACKER[0]], ATTACKER[0]))
def test_clients_of_one_socket_that_took_all_places_are_evicted_at_once(host):
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
    assert all(1_000_000 + index in desk.agent.clients for index in range(300))
    assert len(desk.agent.clients) <= MAX_CLIENTS
    assert "one socket has most of the sessions" in desk.log()
    desk.close()


def test_clients_of_one_socket_are_evicted_though_their_sessions_are_active():
    desk = a_desk()
    fill(desk, lambda key: ATTACKER)
    desk.clock += 10_000
    for client in desk.agent.clients.values():
        client.session.heard = desk.clock
    assert come(desk, 1, BOARD) == OK
    assert come(desk, 2, (ATTACKER[0], 1)) == OK
    desk.close()


@pytest.mark.parametrize(
    "host",
    [
        pytest.param(lambda key: "192.0.2.66", id="IPv4", marks=pytest.mark.slow),
        pytest.param(lambda key: f"2001:db8::{key:x}", id="IPv6 /64"),
    ],
)
@pytest.mark.parametrize(
    "new_address", slow_except(["192.0.2.7", "2001:db8:0:1::7", "the same"], "192.0.2.7")
)
def test_silent_clients_of_many_sockets_of_one_address_are_evicted(host, new_address):
    desk = a_desk()
    fill(desk, lambda key: (host(key), key))
    board = host(1) if new_address == "the same" else new_address, 1
    if new_address == "the same":
        assert come(desk, 1, board) == RESOURCES  # they might be boards that have just started
        desk.clock += module.SILENT_MS
    assert come(desk, 1, board) == OK  # places are reserved for other addresses
    for number in range(2, 600):
        desk.clock += module.SILENT_MS // 10
        desk.agent.clients[1].session.heard = desk.clock
        assert come(desk, number, (board[0], 10_000 + number)) == OK
    assert 1 in desk.agent.clients
    desk.close()


def test_one_address_cannot_have_all_places_with_active_clients():
    desk = a_desk()
    fill(desk, lambda key: ("192.0.2.66", key))
    assert come(desk, 1, ("192.0.2.66", 1)) == RESOURCES
    assert len(desk.agent.clients) == ONE
    for number in range(100, 250):
        assert come(desk, number, (f"192.0.2.{number}", 1)) == OK
    desk.close()


def test_an_active_board_is_never_evicted():
    desk = a_desk(100)
    for number in range(100):
        assert come(desk, 1 + number, (f"192.0.2.{number}", 1)) == OK
    desk.clock += 60_000  # silent subscribers
    for number in range(50):
        assert come(desk, 5000 + number, (f"198.51.100.{number}", 1)) == RESOURCES
    assert set(desk.agent.clients) == set(range(1, 101))
    desk.close()


def test_a_small_max_clients_evicts_no_client_of_the_same_address():
    """A twenty-first board does not evict one of twenty silent boards behind one address."""
    desk = a_desk(20)
    for number in range(20):
        assert come(desk, 1 + number, ("192.0.2.9", number)) == OK
    desk.clock += 60_000
    assert come(desk, 99, ("192.0.2.9", 99)) == RESOURCES
    assert set(desk.agent.clients) == set(range(1, 21))
    desk.close()


def test_clients_with_the_fewest_objects_and_the_newest_are_evicted_first():
    desk = a_desk(64)
    rich = range(1, 11)
    for key in rich:
        assert come(desk, key, ATTACKER, objects=4) == OK
    for key in range(11, 65):
        assert come(desk, key, ATTACKER) == OK
    before = set(desk.agent.clients)
    assert come(desk, 1000, BOARD) == OK
    assert before - set(desk.agent.clients) == {61, 62, 63, 64}  # a sixteenth of them: the latest
    assert come(desk, 1001, ("192.0.2.9", 1)) == OK
    assert set(rich) <= set(desk.agent.clients)
    desk.close()


@pytest.mark.parametrize("medium", ["line", "bus"])
def test_boards_of_a_line_or_a_bus_are_evicted_for_a_board_of_the_network(medium):
    """On serial lines and CAN, the network is the transport, and the socket is a peer's number."""
    desk = a_desk(64)
    network = desk.place
    desk.place = line = Place()
    for key in range(1, 65):
        assert come(desk, key, 1 if medium == "line" else key) == OK
    desk.place = network
    if medium == "bus":
        desk.clock += module.SILENT_MS
    assert come(desk, 1000, BOARD) == OK
    assert desk.agent.place(1000)[0] is network and line is not network
    desk.close()


@pytest.mark.slow
def test_a_refused_flood_causes_at_most_ten_searches_a_second(monkeypatch):
    desk = a_desk()
    fill(desk, lambda key: ("192.0.2.66", key))
    looks = []
    silent = EvictionPolicy._silent
    monkeypatch.setattr(EvictionPolicy, "_silent", lambda *args: looks.append(1) or silent(*args))
    for number in range(1000):
        assert come(desk, 1_000_000 + number, ("192.0.2.66", 10_000 + number)) == RESOURCES
        desk.clock += 1
    assert len(looks) <= 11
    desk.close()


def test_a_flood_over_the_limit_is_served_in_time():
    """Each new client of a flood and its evictions take a limited time."""
    desk = a_desk()
    fill(desk, lambda key: ATTACKER, objects=0)
    before = time.process_time()
    for key in range(10_000, 14_096):
        desk.hear(create_client(key, 0x05), ATTACKER)
    assert time.process_time() - before < 12.0
    desk.close()


# --- the counts ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "address, other_address, same",
    [
        ("192.0.2.1", "192.0.2.1", True),
        ("192.0.2.1", "192.0.2.2", False),
        ("2001:db8::1", "2001:db8::ffff:1", True),
        ("2001:db8:0:1::1", "2001:db8:0:2::1", False),
        ("fe80::1%eth0", "fe80::2%eth1", True),
        ("::ffff:192.0.2.1", "192.0.2.1", True),
    ],
)
def test_the_network_of_an_address(address, other_address, same):
    place = Addresses()
    assert (network_of(place, (address, 1)) == network_of(place, (other_address, 2))) == same


def test_a_line_is_a_network_of_its_own():
    first, second = Place(), Place()
    assert network_of(first, 1) == network_of(first, 2) != network_of(second, 1)


@given(
    st.lists(
        st.tuples(st.sampled_from("cdw"), st.integers(1, 30), st.integers(0, 2), st.integers(0, 4)),
        max_size=120,
    )
)
def test_the_counts_always_equal_the_clients(steps):
    desk = a_desk(20)
    for step, key, host, port in steps:
        if step == "c":
            desk.hear(create_client(key, 0x05 if port else 0x81), (f"192.0.2.{host}", port))
        elif step == "d":
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
