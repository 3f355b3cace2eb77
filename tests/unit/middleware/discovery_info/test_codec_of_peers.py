"""Decoding ``ros_discovery_info`` of other participants, from bytes written by hand."""

import pytest

from uros.middleware.discovery_info.codec import decode

GUID = bytes(range(1, 17))
READER, WRITER = b"r" * 16, b"w" * 16


def sample(pad):
    """One participant, one node ``/ns`` ``n`` with a reader and a writer, little endian."""
    return b"".join(
        [
            b"\0\1\0\0",
            GUID + pad,
            b"\1\0\0\0",
            b"\4\0\0\0/ns\0",
            b"\2\0\0\0n\0\0\0",  # two octets of padding
            b"\1\0\0\0" + READER + pad,
            b"\1\0\0\0" + WRITER + pad,
        ]
    )


def check(decoded, gid_size=16):
    guid, (node,), size = decoded
    assert (guid, size) == (GUID, gid_size)
    assert (node.namespace, node.name) == ("/ns", "n")
    assert (node.readers, node.writers) == ([READER], [WRITER])


@pytest.mark.parametrize("pad", [b"", bytes(8)], ids=["iron", "humble"])
def test_both_sizes_of_a_gid(pad):
    check(decode(sample(pad)), 16 + len(pad))


@pytest.mark.parametrize("pad", [b"", bytes(8)])
def test_no_nodes(pad):
    assert decode(b"\0\1\0\0" + GUID + pad + bytes(4)) == (GUID, [], 16 + len(pad))


def test_big_endian():
    big = b"".join(
        [
            b"\0\0\0\0" + GUID + b"\0\0\0\1",
            b"\0\0\0\4/ns\0\0\0\0\2n\0\0\0",
            b"\0\0\0\1" + READER + b"\0\0\0\1" + WRITER,
        ]
    )
    check(decode(big))


def test_padding_at_the_end():
    check(decode(sample(b"") + bytes(3)))


def test_bad_samples_are_none():
    good = sample(b"")
    for size in range(len(good)):
        assert decode(good[:size]) is None, size
    assert decode(good + b"rest") is None
    assert decode(b"\0\3" + good[2:]) is None
    assert decode(b"\0\1\0\0" + GUID + b"\xff\xff\xff\xff") is None
    assert decode(good.replace(b"/ns\0", b"/nsx")) is None
    assert decode(good.replace(b"/ns\0", b"/\xff\xfe\0")) is None
