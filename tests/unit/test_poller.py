"""The poller of this system and the one of selectors do the same."""

import os
import select
import selectors
import socket
import threading

import pytest

from uros import poller


def by_select():
    """As on Windows, which has nothing else."""
    return poller.SelectorPoller(selectors.SelectSelector())


@pytest.fixture(
    params=[poller.create, poller.SelectorPoller, by_select],
    ids=["create", "selectors", "select"],
)
def polled(request):
    made = request.param()
    yield made
    made.close()


@pytest.fixture
def pair():
    ends = socket.socketpair()
    yield ends
    for end in ends:
        end.close()


def test_what_is_readable_is_returned_until_it_is_read(polled, pair):
    calls = []
    polled.watch(pair[0].fileno(), lambda: calls.append(pair[0].recv(10)))
    assert polled.poll(0) == []
    pair[1].send(b"one")
    (first,), (again,) = polled.poll(None), polled.poll(0)
    assert first is again
    first()
    assert calls == [b"one"] and polled.poll(0) == []


def test_a_second_watch_replaces_what_is_called_and_when(polled, pair):
    def one():
        pass

    def other():
        pass

    polled.watch(pair[0].fileno(), one)
    polled.watch(pair[0].fileno(), other, writing=True)
    assert polled.poll(1) == [other]  # it can be written
    polled.watch(pair[0].fileno(), one)
    assert polled.poll(0) == []
    pair[1].send(b"x")
    assert polled.poll(1) == [one]


def test_unwatch_forgets_and_may_be_repeated(polled, pair):
    polled.watch(pair[0].fileno(), pytest.fail)
    pair[1].send(b"x")
    polled.unwatch(pair[0].fileno())
    polled.unwatch(pair[0].fileno())
    assert polled.poll(0) == []


def test_a_number_of_a_closed_descriptor_is_watched_anew(polled):
    """The system gives a new descriptor the lowest number that is free."""
    reading, writing = os.pipe()
    polled.watch(reading, pytest.fail)
    polled.unwatch(reading)
    os.close(reading)
    os.close(writing)
    again, writing = os.pipe()
    assert again == reading
    polled.watch(again, lambda: None)
    os.write(writing, b"x")
    assert len(polled.poll(1)) == 1
    os.close(again)
    os.close(writing)


def is_readable(fileno, seconds=20):
    return bool(select.select([fileno], [], [], seconds)[0])


def test_a_descriptor_is_readable_while_one_of_its_own_is(polled, pair):
    polled.watch(pair[0].fileno(), lambda: None)
    assert not polled.poll(0) and not is_readable(polled.fileno(), 0)
    pair[1].send(b"x")
    assert is_readable(polled.fileno())
    assert len(polled.poll(0)) == 1 and is_readable(polled.fileno())  # it was not received
    pair[0].recv(10)
    assert not polled.poll(0) and not is_readable(polled.fileno(), 0)
    pair[1].send(b"y")
    assert is_readable(polled.fileno())


def test_the_descriptor_follows_what_is_watched(polled, pair):
    fileno = polled.fileno()
    assert not polled.poll(0)
    polled.watch(pair[0].fileno(), lambda: None)
    pair[1].send(b"x")
    assert is_readable(fileno)
    polled.unwatch(pair[0].fileno())
    for _ in range(100):  # a thread may have been in the middle of it
        assert not polled.poll(0)
        if not is_readable(fileno, 0.05):
            break
    else:
        pytest.fail("it is readable for what is no longer watched")
    polled.watch(pair[1].fileno(), lambda: None, writing=True)
    assert is_readable(fileno)


def test_the_descriptor_of_who_handles_all_without_a_poll(polled, pair):
    polled.watch(pair[0].fileno(), lambda: None)
    for _ in range(2):
        pair[1].send(b"x")
        assert is_readable(polled.fileno())
        pair[0].recv(10)
        polled.rearm()
        assert not is_readable(polled.fileno(), 0)
    pair[1].send(b"x")
    assert is_readable(polled.fileno())
    polled.rearm()  # too early: it has not been received
    assert is_readable(polled.fileno())


def test_the_thread_ends_with_its_poller(pair):
    before = set(threading.enumerate())
    polled = by_select()
    assert set(threading.enumerate()) == before, "without need"
    polled.watch(pair[0].fileno(), lambda: None)
    polled.fileno()
    (thread,) = set(threading.enumerate()) - before
    polled.close()
    assert not thread.is_alive()


def test_has_input_tells_whether_a_receive_finds_something(pair, monkeypatch):
    ours, other = pair
    assert not poller.has_input(ours.fileno())
    other.send(b"one")
    assert poller.has_input(ours.fileno())
    ours.recv(10)
    assert not poller.has_input(ours.fileno())
    monkeypatch.setattr(poller, "_FIONREAD", 0)  # as on Windows: it has to be tried
    assert poller.has_input(ours.fileno())


def test_one_ready_descriptor_of_many_is_returned_alone(polled):
    pairs = [socket.socketpair() for _ in range(3)]
    for ours, _ in pairs:
        polled.watch(ours.fileno(), ours.fileno)
    for count, (_, other) in enumerate(pairs, 1):
        other.send(b"x")
        assert {call() for call in polled.poll(1)} == {ours.fileno() for ours, _ in pairs[:count]}
    for both in pairs:
        for end in both:
            end.close()
