"""The time of ``/clock``, in a domain of the test's own."""

from types import SimpleNamespace

import pytest

from uros.host.network import Network
from uros.interfaces import load
from uros.interfaces.codec import to_cdr
from uros.qos import QoSProfile
from uros.tools import sim_time
from uros.tools.topic import pub

CLOCK = load("rosgraph_msgs/msg/Clock")


@pytest.fixture
def network(own_domain_id):
    with Network(own_domain_id) as network:
        yield network


@pytest.fixture
def set_clock(network):
    writer = network.node.create_writer("rt/clock", CLOCK._DDS_TYPE, QoSProfile())

    def publish(seconds):
        message = CLOCK()
        message.clock.sec, message.clock.nanosec = divmod(round(seconds * 1e9), 10**9)
        writer.write(to_cdr(message))

    return publish


def options(**values):
    return SimpleNamespace(use_sim_time=True, rate=10.0, **values)


def test_the_time_is_that_of_the_latest_message(network, set_clock, capsys):
    now = sim_time.clock(network, options())
    assert now() == 0
    for seconds in (100.25, 7.0):  # it may go back
        set_clock(seconds)
        assert network.spin(lambda: now() == seconds * 1e9, 10)  # noqa: B023
    assert capsys.readouterr().err == ""


def test_without_the_option_it_is_the_systems(network):
    now = sim_time.clock(network, SimpleNamespace(use_sim_time=False))
    assert now() > 1_700_000_000 * 10**9


def test_a_clock_that_cannot_be_read_is_told(network, capsys):
    writer = network.node.create_writer("rt/clock", CLOCK._DDS_TYPE, QoSProfile())
    heard = []
    now = sim_time.clock(network, options())
    network.listen(sim_time.TOPIC, CLOCK._TYPE, QoSProfile(), heard.append)
    writer.write(b"\0\1\0\0\1\0\0\0")
    assert network.spin(lambda: heard, 10)
    network.spin(lambda: False, 0.01)
    assert now() == 0 and "could not be read" in capsys.readouterr().err


def test_messages_are_published_by_the_time_of_the_clock(network, set_clock, monkeypatch):
    """Every 0.1 s on /clock; a time that went back does not hold the next one up."""
    now = sim_time.clock(network, options())
    set_clock(50)
    assert network.spin(now, 10)
    monkeypatch.setattr(pub, "clock", lambda *_: now)
    pace = pub._Pace(network, options())
    for seconds in (50.1, 50.2, 20.0, 20.1):
        set_clock(seconds)
        pace.wait()
        assert now() == round(seconds * 1e9)
