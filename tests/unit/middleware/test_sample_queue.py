"""Samples that wait in a reader, against a plain list of them."""

from hypothesis import given
from hypothesis import strategies as st

from uros.middleware.sample_queue import SampleQueue

STEPS = st.lists(
    st.one_of(
        st.tuples(st.just("put"), st.binary(max_size=5)),
        st.tuples(st.just("take"), st.integers(0, 4)),
        st.tuples(st.just("arrived"), st.integers(0, 5)),
    ),
    max_size=60,
)


@given(depth=st.one_of(st.none(), st.integers(1, 6)), steps=STEPS)
def test_each_size_is_reported_once_while_its_sample_waits(depth, steps):
    queue = SampleQueue(depth, len)
    plain = []  # [sample, whether its size was reported]
    dropped = 0
    for what, value in steps:
        if what == "put":
            queue.put(value)
            plain.append([value, False])
            if depth is not None:
                dropped += len(plain) > depth
                plain = plain[-depth:]
        elif what == "take":
            assert queue.take(value) == [sample for sample, _ in plain[:value]]
            del plain[:value]
        elif what == "arrived":
            new = [entry for entry in plain if not entry[1]][:value]
            assert queue.arrived(value) == [len(sample) for sample, _ in new]
            for entry in new:
                entry[1] = True
        assert len(queue) == len(plain) and queue.dropped == dropped


def test_clear_forgets_all():
    queue = SampleQueue(None, len)
    queue.put(b"a")
    queue.clear()
    assert len(queue) == 0 and queue.arrived(9) == []
