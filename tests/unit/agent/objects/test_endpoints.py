"""The path of a sample through a WriterEndpoint: gate, limiter, middleware, account, recorder."""

import gc

import pytest

from uros.agent.objects.endpoints import WriterEndpoint
from uros.agent.policy.memory_budget import MESSAGE_BYTES, unlimited
from uros.agent.policy.rules import Rule, Settings
from uros.qos import DurabilityPolicy, QoSProfile

SAMPLE = b"\0\1\0\0data"
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Writer:
    """A middleware writer with scripted return values."""

    def __init__(self, calls, answers=(), readers=0):
        self.calls = calls
        self.answers = list(answers)
        self.readers = readers
        self.closed = False

    def write(self, sample):
        accepted = self.answers.pop(0) if self.answers else True
        self.calls.append(("write", bytes(sample), accepted))
        return accepted

    def matched(self):
        self.calls.append(("matched",))
        return self.readers

    def close(self):
        self.closed = True


def limiter(**limits):
    return Settings([Rule(**limits)], lambda: 0.0).limiter


@pytest.fixture
def calls():
    return []


def make(calls, qos=None, **more):
    """An endpoint with every condition that can hold back or drop a sample."""
    writer = Writer(calls, more.pop("answers", ()))
    endpoint = WriterEndpoint(
        writer, qos or QoSProfile(), unlimited(), on_too_large=calls.append, **more
    )
    return writer, endpoint


def record_in(calls):
    return lambda sample: calls.append(("record", bytes(sample)))


def test_without_conditions_a_sample_goes_straight_to_the_middleware(calls):
    writer, endpoint = make(calls, answers=[False, True])
    assert endpoint._direct == writer.write
    assert not endpoint.write(memoryview(SAMPLE)) and endpoint.written == 0
    assert endpoint.write(memoryview(SAMPLE)) and endpoint.written == 1


def test_the_order_is_gate_limiter_middleware_recorder(calls):
    writer, endpoint = make(calls, limiter=limiter(max_rate=1.0))
    # The order of the assignments does not matter.
    endpoint.set_recorder(record_in(calls))
    endpoint.set_gate(lambda matched: calls.append(("gate", matched)) or matched > 0)
    assert not endpoint.write(memoryview(SAMPLE))
    assert calls == [("matched",), ("gate", 0)]  # a closed gate costs no token
    calls.clear()
    writer.readers = 2
    assert endpoint.write(memoryview(SAMPLE))
    assert calls == [("matched",), ("gate", 2), ("write", SAMPLE, True), ("record", SAMPLE)]
    calls.clear()
    assert not endpoint.write(memoryview(SAMPLE))  # the token is used, the gate was opened once
    assert calls == []
    assert endpoint.written == 1


def test_a_sample_over_max_size_is_neither_written_nor_recorded(calls):
    _, endpoint = make(calls, limiter=limiter(max_size=4), qos=LATCHED)
    endpoint.set_recorder(record_in(calls))
    assert endpoint.write(memoryview(SAMPLE))  # dropped for good
    assert calls == ["8 bytes are over max_size 4"]
    assert endpoint.written == 0 and endpoint.unread == 0


def test_a_sample_that_the_middleware_refuses_is_not_recorded(calls):
    _, endpoint = make(calls, qos=LATCHED, answers=[False, True])
    endpoint.set_recorder(record_in(calls))
    assert not endpoint.write(memoryview(SAMPLE))
    assert calls == [("write", SAMPLE, False)] and endpoint.unread == 0
    assert endpoint.write(memoryview(SAMPLE))
    assert calls[-1] == ("record", SAMPLE)
    assert endpoint.unread == len(SAMPLE) + MESSAGE_BYTES and endpoint.written == 1


def test_a_republished_sample_passes_gate_and_limiter(calls):
    _, endpoint = make(calls, qos=LATCHED, limiter=limiter(max_size=1))
    endpoint.set_gate(lambda matched: False)
    endpoint.republish(SAMPLE)
    assert calls == [("write", SAMPLE, True)]
    assert endpoint.written == 1 and endpoint.unread == len(SAMPLE) + MESSAGE_BYTES


def test_no_reference_cycle_keeps_a_closed_endpoint(calls):
    gc.disable()
    try:
        _, endpoint = make(calls, qos=LATCHED, limiter=limiter(max_rate=10.0))
        endpoint.set_recorder(record_in(calls))
        endpoint.write(memoryview(SAMPLE))
        endpoint.close()
        gc.collect()
        del endpoint
        assert gc.collect() == 0
    finally:
        gc.enable()
