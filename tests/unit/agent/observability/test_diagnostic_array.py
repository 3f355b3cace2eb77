"""DiagnosticArray in CDR: octets written by hand, and the generated class as the other codec."""

from hypothesis import given
from hypothesis import strategies as st

from uros.agent.observability import diagnostic_array
from uros.agent.observability.diagnostic_array import TYPE, DiagnosticArray, Status
from uros.interfaces import load
from uros.interfaces.codec import from_cdr, to_cdr

MESSAGE = load("diagnostic_msgs/msg/DiagnosticArray")
STATUS = load("diagnostic_msgs/msg/DiagnosticStatus")
KEY_VALUE = load("diagnostic_msgs/msg/KeyValue")
TEXTS = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=12)
STATUSES = st.builds(
    Status, st.integers(0, 3), TEXTS, TEXTS, TEXTS, st.lists(st.tuples(TEXTS, TEXTS), max_size=4)
)


def packed(stamp, statuses):
    array = DiagnosticArray(stamp)
    for status in statuses:
        array.add(status)
    return array.finish()


def by_the_class(stamp, statuses):
    message = MESSAGE()
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
    for status in statuses:
        values = [KEY_VALUE(key=key, value=value) for key, value in status.values]
        message.status.append(STATUS(*status[:4], values))
    return to_cdr(message)


def test_octets_of_two_statuses():
    """Padding is before a length, never after the last string: a level follows at once."""
    statuses = [
        Status(2, "ab", "c", "", [("k", "vw")]),
        Status(1, "", "", "", []),
    ]
    assert packed(3 * 10**9 + 7, statuses) == bytes.fromhex(
        "00010000"  # plain CDR, little endian
        "03000000 07000000"  # stamp
        "01000000 00 000000"  # frame_id "", padding
        "02000000"  # two statuses
        "02 000000 03000000 616200 00"  # level, padding, name, padding
        "02000000 6300 0000 01000000 00 000000"  # message, hardware_id
        "01000000 02000000 6b00 0000 03000000 767700"  # one value; no padding behind the last
        "01 01000000 00 000000 01000000 00 000000 01000000 00 000000 00000000"
    )


@given(st.integers(0, 2**31 * 10**9 - 1), st.lists(STATUSES, max_size=4))
def test_the_same_octets_as_the_generated_class(stamp, statuses):
    assert packed(stamp, statuses) == by_the_class(stamp, statuses)


def test_text_that_is_no_utf8_is_replaced():
    """A lone surrogate in a name of a board must not stop the others' statuses."""
    message = from_cdr(MESSAGE, packed(0, [Status(0, "a\ud800b", "", "", [("k", "\udfff")])]))
    assert (message.status[0].name, message.status[0].values[0].value) == ("a?b", "?")


def test_the_type_and_its_levels_are_those_of_the_definition():
    assert MESSAGE._DDS_TYPE == TYPE
    for name in ("OK", "WARN", "ERROR", "STALE"):
        assert getattr(diagnostic_array, name) == getattr(STATUS, name)
