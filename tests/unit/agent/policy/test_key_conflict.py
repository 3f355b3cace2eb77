"""Key conflicts: which of two clients with one key is served, and floods of claimants."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.agent import RunningAgent, running_agent, serving
from support.certificates import Authority
from support.client import XrceClient
from support.lines import TcpLine, TlsLine, UdpLine
from support.waiting import eventually
from unit.agent.helpers import (
    KEY,
    PARTICIPANT,
    WRITER,
    Board,
    Desk,
    Place,
    acknack,
    create_client,
    delete,
    get_info,
    message,
    parse,
    participant,
    publisher_entities,
    topic,
    write_data,
)

from uros.agent.policy import key_conflict as module
from uros.agent.transports.certificates import Certificates
from uros.agent.transports.tcp import TcpServer
from uros.agent.transports.tls import TlsServer
from uros.agent.transports.udp import UdpServer
from uros.wire import ids

DECIDED = sum(module.WAIT_MS) + 10
OK, DENIED = ids.STATUS_OK, ids.STATUS_ERR_DENIED
# The answer of C clients to GET_INFO: zeros in place of the submessage header.
ALIVE = bytes.fromhex("81000000 00000000 00000000")


def statuses(sent, peer):
    """Return the statuses of the peer's CREATE_CLIENT requests."""
    answers = [parse(datagram)[1][0] for to, datagram in sent if to == peer]
    return [payload[0] for kind, _, payload in answers if kind == ids.STATUS_AGENT]


def questions(sent, peer):
    return [parse(datagram)[1][0][0] for to, datagram in sent if to == peer].count(ids.GET_INFO)


def of(desk, key=KEY):
    return desk.agent._places[key][1]


# --- who gets it -----------------------------------------------------------------------------


def test_an_incumbent_that_answers_wins_and_the_claimant_is_refused(desk):
    board = Board(desk, 1)
    board.ask(*publisher_entities())
    sent = desk.hear(create_client(), 2)
    assert questions(sent, 1) == 1 and not statuses(sent, 2)
    desk.hear(ALIVE, 1)
    assert statuses(desk.wait(DECIDED), 2) == [DENIED]
    assert of(desk) == 1
    board.send(write_data(WRITER, b"still here"))
    assert board.ask(participant()) == [ids.STATUS_ERR_ALREADY_EXISTS]
    (line,) = [log_line for log_line in desk.log().splitlines() if "client key in use" in log_line]
    assert (
        "client_key: 0xAABBCCDD, refused at peer 2: the client at peer 1 answers"
        " (give each board a key of its own)"
    ) in line
    assert desk.agent.refusals[KEY][:3] == ("client key in use", "peer 2", 1)


@pytest.mark.parametrize(
    "answer",
    [message([acknack(0)], 0), message([get_info()], 0, 0, 0x80), create_client()],
    ids=["acknack", "ping outside of the session", "it was reset itself"],
)
def test_any_message_from_the_incumbents_address_answers_the_probe(desk, answer):
    Board(desk, 1)
    desk.hear(create_client(), 2)
    desk.wait(400)
    desk.hear(answer, 1)
    assert statuses(desk.wait(DECIDED), 2) == [DENIED]
    assert of(desk) == 1


def test_a_silent_incumbent_loses_and_the_claimant_is_admitted_at_once(desk):
    Board(desk, 1).ask(*publisher_entities())
    sent = desk.hear(create_client(mtu=1000), 2) + desk.wait(DECIDED)
    assert questions(sent, 1) == len(module.WAIT_MS)
    assert statuses(sent, 2) == [OK]
    assert of(desk) == 2
    assert desk.agent.clients[KEY].session.mtu == 1000
    assert list(desk.place.sessions) == [2]
    assert desk.agent.clients[KEY].objects  # the same session id: the objects stay
    assert not desk.agent.refusals
    # The new incumbent is probed in turn when the first client comes again.
    assert questions(desk.hear(create_client(), 1), 2) == 1


def test_a_claimant_with_another_session_id_waits_too_and_gets_none_of_the_objects(desk):
    Board(desk, 1).ask(*publisher_entities())
    assert not statuses(desk.hear(create_client(session_id=0x82), 2), 2)
    assert statuses(desk.wait(DECIDED), 2) == [OK]
    assert not desk.agent.clients[KEY].objects
    assert not desk.middleware.bus.nodes


def test_a_claimant_that_repeats_its_request_gets_one_answer_to_the_last(desk):
    Board(desk, 1)
    sent = desk.hear(create_client(mtu=100), 2)
    for _ in range(4):
        sent += desk.wait(100) + desk.hear(create_client(mtu=200), 2)
    sent += desk.wait(DECIDED)
    assert statuses(sent, 2) == [OK]
    assert desk.agent.clients[KEY].session.mtu == 200


def test_a_create_client_from_the_same_address_is_answered_at_once(desk):
    Board(desk, 1)
    assert statuses(desk.hear(create_client(), 1), 1) == [OK]
    assert not desk.agent.key_conflicts._probes


def test_a_claimant_is_admitted_when_the_incumbent_closes_its_session(desk):
    Board(desk, 1)
    desk.hear(create_client(), 2)
    desk.hear(message([delete(ids.OBJECT_CLIENT)], 0), 1)
    assert statuses(desk.wait(DECIDED), 2) == [OK]
    assert of(desk) == 2


def test_a_claimant_over_the_client_limit_is_refused_after_its_wait(desk):
    desk.agent.admission.max_clients = 1
    Board(desk, 1)
    desk.hear(create_client(), 2)
    desk.agent.delete_client(KEY)
    assert Board(desk, 3, 0x33).ask(participant()) == [OK]
    assert statuses(desk.wait(DECIDED), 2) == [ids.STATUS_ERR_RESOURCES]
    assert list(desk.agent.clients) == [0x33]


def test_a_claimant_whose_connection_closes_is_dropped(desk):
    Board(desk, 1)
    desk.hear(create_client(), 2)
    desk.agent.gone(desk.place, 2)
    desk.wait(DECIDED)
    assert of(desk) == 1 and not desk.agent.key_conflicts._probes


def test_without_timers_the_next_request_decides(desk):
    """Programs may use an Agent without a Server."""
    Board(desk, 1)
    desk.agent.wake_at = lambda seconds, call: None
    out = []
    for _ in range(4):
        out += statuses(desk.hear(create_client(), 2), 2)
        desk.clock += 250
    assert out == [OK] and of(desk) == 2


# --- rights ------------------------------------------------------------------------------------


def certified(desk, monkeypatch, shown):
    """Peers of the desk show these certificates."""
    monkeypatch.setattr(desk.place, "certificate_of", lambda peer: shown.get(peer), raising=True)


def test_the_key_of_a_certificate_is_not_given_to_another_certificate(desk, monkeypatch):
    certified(desk, monkeypatch, {1: "left", 3: "right"})
    Board(desk, 1).ask(*publisher_entities())
    for peer in (2, 3):
        sent = desk.hear(create_client(), peer)
        assert statuses(sent, peer) == [DENIED] and not questions(sent, 1)
        assert not desk.wait(DECIDED)
    desk.hear(create_client(session_id=0x82), 2)
    desk.wait(60_000)
    assert of(desk) == 1 and desk.agent.clients[KEY].objects
    assert (
        "refused at peer 2: the client at peer 1 showed a certificate, and the key is reserved for"
        " that certificate (give each board a key of its own)"
    ) in desk.log()


def test_the_same_certificate_takes_over_the_key_with_its_objects(desk, monkeypatch):
    certified(desk, monkeypatch, {1: "left", 4: "left"})
    Board(desk, 1).ask(*publisher_entities())
    sent = desk.hear(create_client(), 4) + desk.wait(DECIDED)
    assert statuses(sent, 4) == [OK] and of(desk) == 4
    assert desk.agent.clients[KEY].objects
    assert desk.agent.clients[KEY].certificate == "left"
    assert statuses(desk.hear(create_client(), 2) + desk.wait(DECIDED), 2) == [DENIED]


def test_the_key_of_a_certificate_is_free_when_its_client_has_left(desk, monkeypatch):
    certified(desk, monkeypatch, {1: "left"})
    Board(desk, 1).send(delete(ids.OBJECT_CLIENT))
    assert statuses(desk.hear(create_client(), 2), 2) == [OK]


def test_a_certificate_takes_over_a_key_without_one_and_none_of_the_objects(desk, monkeypatch):
    certified(desk, monkeypatch, {1: "left"})
    Board(desk, 2).ask(*publisher_entities())
    assert statuses(desk.hear(create_client(), 1) + desk.wait(DECIDED), 1) == [OK]
    assert of(desk) == 1 and desk.agent.clients[KEY].certificate == "left"
    assert not desk.agent.clients[KEY].objects and not desk.middleware.bus.nodes


def test_a_claimant_of_another_transport_gets_none_of_the_objects(desk):
    Board(desk, 1).ask(*publisher_entities())
    first = desk.agent.clients[KEY]
    desk.place, before = Place(), desk.place
    assert not statuses(desk.hear(create_client(), 1), 1)
    assert before.sent  # the incumbent was probed
    assert statuses(desk.wait(DECIDED), 1) == [OK]
    assert desk.agent.clients[KEY] is not first and not desk.agent.clients[KEY].objects
    assert not desk.middleware.bus.nodes and not before.sessions


@pytest.mark.parametrize("session_id", [0x05, 0x81])
def test_a_claimant_with_other_rules_gets_none_of_the_objects(desk, session_id):
    desk.agent.rules.add({"address": "peer 1", "namespace": "/left"})
    desk.agent.rules.add({"address": ["peer 1", "peer 3"], "key": 5, "max_rate": 3})
    Board(desk, 1, session_id=session_id).ask(*publisher_entities())
    datagram = message([write_data(WRITER, b"mine")], 0x80, 4, session_id)
    desk.hear(datagram, 2)
    desk.wait(DECIDED)  # a message alone does not move the session, as it does not create one
    assert of(desk) == 1 and "unknown session" in desk.log()
    assert statuses(desk.hear(create_client(session_id=session_id), 2) + desk.wait(DECIDED), 2) == [
        OK
    ]
    assert of(desk) == 2 and not desk.agent.clients[KEY].objects
    board = Board(desk, 2, session_id=session_id)
    board.ask(*publisher_entities())
    assert {key[1] for key in desk.middleware.bus.writers} == {"rt/chatter"}
    sent = desk.hear(create_client(session_id=session_id), 3) + desk.wait(DECIDED)
    assert statuses(sent, 3) == [OK]
    assert desk.agent.clients[KEY].objects  # the same rules


def test_a_waiting_claimant_does_not_displace_a_client_admitted_meanwhile(desk, monkeypatch):
    certified(desk, monkeypatch, {3: "left"})
    Board(desk, 1)
    desk.hear(create_client(), 2)  # the claimant waits
    desk.hear(message([delete(ids.OBJECT_CLIENT)], 0), 1)
    assert statuses(desk.hear(create_client(), 3), 3) == [OK]
    assert statuses(desk.wait(DECIDED), 2) == [DENIED]
    assert of(desk) == 3


# --- a key in every header ---------------------------------------------------------------------


def test_a_session_with_its_key_in_the_header_moves_when_its_old_address_is_silent(desk):
    board = Board(desk, 1, session_id=0x05)
    board.ask(participant())
    datagram = message([topic()], 0x80, 1, 0x05)
    assert questions(desk.hear(datagram, 7), 1) == 1
    assert len(desk.agent.clients[KEY].objects) == 1
    desk.wait(DECIDED)
    assert of(desk) == 7
    desk.hear(datagram, 7)
    assert len(desk.agent.clients[KEY].objects) == 2


def test_the_key_alone_gives_no_access_to_a_live_session(desk):
    board = Board(desk, 1, session_id=0x05)
    board.ask(participant())
    for number in range(1, 20):
        desk.hear(message([delete(PARTICIPANT)], 0x80, number, 0x05), 7)
        desk.hear(message([get_info()], 0, 0, 0x05), 1)
        desk.wait(100)
    assert of(desk) == 1
    assert len(desk.agent.clients[KEY].objects) == 1
    assert "client key in use" in desk.log()


# --- floods ------------------------------------------------------------------------------------


def test_a_flood_of_claimants_costs_the_incumbent_three_probes_in_five_seconds(desk):
    board = Board(desk, 1)
    probes, denied = 0, 0
    for number in range(6000):
        sent = desk.hear(create_client(), 2 + number % 50)
        sent += desk.wait(10)
        count = questions(sent, 1)
        probes += count
        denied += sum(len(statuses(sent, peer)) for peer in range(2, 52))
        if count:
            desk.hear(ALIVE, 1)
    assert of(desk) == 1
    assert 1 <= probes <= 60 / 5 * len(module.WAIT_MS)
    assert board.ask(participant()) == [OK]
    assert denied > 5000
    assert desk.log().count("client key in use") < 200
    assert desk.agent.refusals[KEY].times > 5000


def test_loss_of_two_of_three_probe_answers_loses_no_session(desk):
    Board(desk, 1)
    received = 0
    for number in range(3000):
        sent = desk.hear(create_client(), 2 + number % 50) + desk.wait(20)
        for _ in range(questions(sent, 1)):
            received += 1
            if received % 3 == 0:
                desk.hear(ALIVE, 1)
    assert received > 20 and of(desk) == 1


def test_claimants_for_all_clients_at_once_are_bounded(desk):
    for number in range(1, 601):
        desk.hear(create_client(number), number)
    for number in range(1, 601):
        desk.hear(create_client(number), 1000 + number)
    assert len(desk.agent.key_conflicts._probes) == module.MAX_PROBES
    desk.wait(DECIDED)
    assert not desk.agent.key_conflicts._probes
    for number in range(1, 601):
        desk.hear(create_client(number), 1000 + number)
        desk.hear(create_client(number), number)
        desk.wait(1)
    desk.wait(DECIDED)
    assert len(desk.agent.key_conflicts._defended) <= module.MAX_PROBES
    assert len(desk.agent.refusals) <= 256


def test_a_stopped_agent_gives_the_incumbent_its_full_time(desk):
    Board(desk, 1)
    desk.hear(create_client(), 2)
    desk.clock += 60_000  # no timer fired meanwhile, and no message arrived
    sent = desk.wait(0)
    assert not statuses(sent, 2)
    desk.hear(ALIVE, 1)
    assert statuses(desk.wait(DECIDED), 2) == [DENIED]


@given(st.lists(st.tuples(st.integers(1, 4), st.sampled_from("cdpw")), max_size=60))
def test_a_key_always_has_one_client_at_one_address(steps):
    """c: CREATE_CLIENT, d: DELETE, p: ping in the session, w: time passes."""
    desk = Desk()
    for peer, step in steps:
        if step == "c":
            desk.hear(create_client(), peer)
        elif step == "d":
            desk.hear(message([delete(ids.OBJECT_CLIENT)], 0), peer)
        elif step == "p":
            desk.hear(message([get_info()], 0), peer)
        else:
            desk.wait(200 * peer)
        assert len(desk.agent.clients) <= 1
        assert list(desk.place.sessions) == [place[1] for place in desk.agent._places.values()]
    desk.wait(2 * DECIDED)  # a claimant waits anew when another one was admitted before it
    assert not desk.agent.key_conflicts._probes
    desk.close()


# --- over real lines ---------------------------------------------------------------------------


@pytest.mark.parametrize("transport", ["udp", "tcp"])
def test_two_boards_with_one_key_over_real_sockets(transport):
    with running_agent(transport, "memory") as running:
        first, second = (XrceClient(running.line(i), 0x77) for i in range(2))
        assert first.open() == OK
        writer = first.writer("n", "rt/a", "T")
        reader = first.reader("n", "rt/a", "T")
        first.read(reader)
        answers = []

        def poll_answers():
            """The first client only listens; the second requests the key."""
            datagram = second.line.receive(0)
            if datagram is not None:
                second.take(datagram)
                answers.append(second.agent_status)
            return answers

        second.line.send(create_client(0x77))
        first.until(poll_answers, "the second is not answered")
        assert answers == [DENIED]
        first.write(writer, b"undisturbed")
        assert first.sample(reader) == b"undisturbed"
        assert "0x77" in f"{[hex(key) for key in running.agent.refusals]}"
        assert running.agent.refusals[0x77].why == "client key in use"


def test_a_board_that_moves_to_another_port_goes_on_there_with_its_objects():
    with running_agent("udp", "memory") as running:
        first, second = (XrceClient(running.line(i), 0x77) for i in range(2))
        assert first.open() == OK
        first.participant("n")
        first.line.close()
        running.lines.remove(first.line)
        assert second.open() == OK
        assert second.ping() == 1
        assert len(running.agent.clients[0x77].objects) == 1


def test_a_client_moves_from_one_transport_to_another():
    udp, tcp = UdpServer(0, "127.0.0.1"), TcpServer(0, "127.0.0.1")
    with running_agent(udp, "memory") as running:
        tcp_added = _second(running, tcp)
        first = XrceClient(UdpLine(udp.port), 0x77)
        second = XrceClient(TcpLine(tcp_added.port), 0x77)
        running.lines += [first.line, second.line]
        assert first.open() == OK
        assert second.open() == OK
        assert not udp.sessions and len(tcp.sessions) == 1


def _second(running, transport):
    """Add a transport to a running agent."""
    from threading import Event

    done = Event()

    def add():
        transport.open(running.server)
        running.server.transports.append(transport)
        done.set()

    running.server.wake_at(0.0, add)
    while not done.wait(0.01):
        running.server._wake.set()
    return transport


# --- with TLS ----------------------------------------------------------------------------------


@pytest.fixture
def mutual(tmp_path):
    """(agent, authority, UDP): an agent with mutual TLS, and UDP beside it."""
    authority = Authority(tmp_path)
    tls = TlsServer(0, "127.0.0.1", Certificates(*authority.agent(), authority.ca))
    with serving(RunningAgent(tls, "memory", 0, 4)) as running:
        running.agent.rules.add({"address": "*(CN=left)", "namespace": "/left"})
        yield running, authority, _second(running, UdpServer(0, "127.0.0.1"))


def _line(running, authority, name):
    line = TlsLine(running.transport.port, authority.client(name))
    running.lines.append(line)
    return line


def _topics(running):
    return sorted({key[1] for key, writers in running.middleware.bus.writers.items() if writers})


@pytest.mark.parametrize("claimant_kind", ["plain UDP", "CN=right"])
def test_the_key_of_a_board_with_a_certificate_is_not_taken_over(mutual, claimant_kind):
    running, authority, udp = mutual
    left_client = XrceClient(_line(running, authority, "left"), 0x77)
    assert left_client.open() == OK
    left_client.writer("n", "rt/a", "T")
    line = UdpLine(udp.port) if claimant_kind == "plain UDP" else _line(running, authority, "right")
    running.lines.append(line)
    claimant = XrceClient(line, 0x77)
    assert claimant.open() == DENIED  # the client "left" reads nothing and answers nothing
    assert running.agent.place(0x77)[0] is running.transport
    assert _topics(running) == ["rt/left/a"]
    assert left_client.ping() == 1
    left_client.line.close()  # now the session is closed, and the key is free
    running.lines.remove(left_client.line)
    eventually(lambda: 0x77 not in running.agent.clients)
    assert claimant.open() == OK
    claimant.writer("n", "rt/a", "T")
    assert _topics(running) == ["rt/a"]


def test_the_same_certificate_takes_over_its_silent_session(mutual):
    running, authority, _ = mutual
    context = authority.client("left")
    clients = []
    for _ in range(2):
        line = TlsLine(running.transport.port, context)
        running.lines.append(line)
        clients.append(XrceClient(line, 0x77))
        assert clients[-1].open() == OK  # the connection of the first is open, but silent
        if len(clients) == 1:
            clients[0].writer("n", "rt/a", "T")
    assert _topics(running) == ["rt/left/a"]
    assert clients[1].ping() == 1


def test_a_board_with_a_certificate_begins_with_its_own_rules(mutual):
    running, authority, udp = mutual
    plain = XrceClient(UdpLine(udp.port), 0x77)
    running.lines.append(plain.line)
    assert plain.open() == OK
    plain.writer("n", "rt/a", "T")
    left_client = XrceClient(_line(running, authority, "left"), 0x77)
    assert left_client.open() == OK
    assert not _topics(running) and not udp.sessions
    left_client.writer("n", "rt/a", "T")
    assert _topics(running) == ["rt/left/a"]
