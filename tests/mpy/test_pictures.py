"""Tests that pictures of 20 kB reach DDS intact, complete and in order, with little memory.

``bench/pictures.py`` measures their rate. At 921,600 baud, 8N1, a line carries 92,160 octets a
second: at most 4.6 pictures of 20,000 octets a second, with any protocol.
"""

import pytest
from support.pictures import picture, shoot

LENGTH = 20_000
COUNT = 25
EXPECTED = [picture(number, LENGTH) for number in range(COUNT)]
HIGH_WATER = 100_000
# Headers, CRCs and escapes take 4.3 % of the line; the rest is for retransmissions, of which there
# are none unless the machine stalls.
OVERHEAD = 1.15


def test_pictures_by_udp(tmp_path, own_domain_id):
    """25 pictures arrive over UDP at 5 Hz, in one session."""
    shot = shoot("udp", tmp_path, own_domain_id, COUNT, 200, LENGTH)
    assert shot.pictures == EXPECTED
    assert (shot.refused, shot.dropped, shot.sessions) == (0, 0, 1)
    print(f"\n{shot.rate:.2f} Hz, high water {shot.heap.peak} bytes")
    assert shot.heap.peak < HIGH_WATER


@pytest.mark.slow
def test_pictures_by_a_serial_line(tmp_path, own_domain_id):
    """25 pictures arrive as fast as 921,600 baud allow, from a UART with a buffer of 512 octets."""
    shot = shoot("uart", tmp_path, own_domain_id, COUNT, 0, LENGTH)
    assert shot.pictures == EXPECTED
    assert (shot.refused, shot.dropped, shot.sessions) == (0, 0, 1)
    print(
        f"\n{shot.rate:.2f} Hz, line {shot.busy:.1%} busy, {shot.octets} octets,"
        f" {shot.lost} lost, high water {shot.heap.peak} bytes"
    )
    assert shot.octets < (COUNT - 1) * LENGTH * OVERHEAD
    assert shot.heap.peak < HIGH_WATER


@pytest.mark.slow
def test_pictures_by_a_line_of_921600_bits_of_data(tmp_path, own_domain_id):
    """25 pictures arrive at 5 Hz by a line that carries 921,600 data bits a second.

    With start and stop bits, as here, that takes a quarter more baud.
    """
    shot = shoot(
        "uart", tmp_path, own_domain_id, COUNT, 200, LENGTH, baud=921_600 * 10 // 8, txbuf=2048
    )
    assert shot.pictures == EXPECTED
    assert (shot.refused, shot.dropped, shot.sessions) == (0, 0, 1)
    print(f"\n{shot.rate:.2f} Hz, line {shot.busy:.1%} busy, high water {shot.heap.peak} bytes")
    assert shot.octets < (COUNT - 1) * LENGTH * OVERHEAD
    assert shot.heap.peak < HIGH_WATER
