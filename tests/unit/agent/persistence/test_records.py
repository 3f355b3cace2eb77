"""The records of a client in the state file: its address."""

import pytest

from uros.agent.persistence.records import ClientInfo, ClientRecords, can_be_kept

# UDP over IPv4 and IPv6, a serial line, a listener of lines, custom transports with one board,
# several boards, and a byte stream.
PLACES = [
    ("192.168.1.7", 2018), ("fe80::1", 2018, 0, 3), 1, ("/dev/rfcomm0", 1), None, "board",
    (None, 1), ("board", 1),
]  # fmt: skip


@pytest.mark.parametrize("peer", PLACES, ids=str)
def test_an_address_that_lasts_is_written_and_read_back(peer):
    assert can_be_kept(peer)
    records = ClientRecords()
    records._apply(ClientInfo(1, 0x81, 512, "UDPv4Agent port 8888", peer).payload())
    assert records.info.peer == peer and type(records.info.peer) is type(peer)


@pytest.mark.parametrize(
    "peer", [object(), (object(), 1), b"board", 1.5], ids=["thing", "pair", "bytes", "float"]
)
def test_an_address_that_does_not_last_is_not_written(peer):
    assert not can_be_kept(peer)
