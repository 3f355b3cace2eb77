"""Pictures of 20 kB from a board to DDS: intact, all of them, in order, in little memory.

How many a second there are is for ``bench/pictures.py`` to say. At 921,600 baud, 8N1, a line
carries 92,160 octets a second: of 20,000 octets not more than 4.6 times as many in a second,
whatever the protocol.
"""

from support.pictures import picture, shoot

LENGTH = 20_000
COUNT = 25
EXPECTED = [picture(number, LENGTH) for number in range(COUNT)]
HIGH_WATER = 100_000
# Headers, CRCs and escapes take 4.3 % of the line; the rest is for what is sent twice, which is
# nothing, unless the machine stands still for a moment.
OVERHEAD = 1.15


def test_pictures_by_udp(tmp_path, own_domain_id):
    """One each 0.2 s: 5 Hz."""
    shot = shoot("udp", tmp_path, own_domain_id, COUNT, 200, LENGTH)
    assert shot.pictures == EXPECTED
    assert (shot.refused, shot.dropped, shot.sessions) == (0, 0, 1)
    print(f"\n{shot.rate:.2f} Hz, high water {shot.heap.peak} bytes")
    assert shot.heap.peak < HIGH_WATER


def test_pictures_by_a_serial_line(tmp_path, own_domain_id):
    """As fast as a line of 921,600 baud goes, out of a UART that takes 512 octets and no more."""
    shot = shoot("uart", tmp_path, own_domain_id, COUNT, 0, LENGTH)
    assert shot.pictures == EXPECTED
    assert (shot.refused, shot.dropped, shot.sessions) == (0, 0, 1)
    print(
        f"\n{shot.rate:.2f} Hz, line {shot.busy:.1%} busy, {shot.octets} octets,"
        f" {shot.lost} lost, high water {shot.heap.peak} bytes"
    )
    assert shot.octets < (COUNT - 1) * LENGTH * OVERHEAD
    assert shot.heap.peak < HIGH_WATER


def test_pictures_by_a_line_of_921600_bits_of_data(tmp_path, own_domain_id):
    """One each 0.2 s. Such a line has neither start nor stop bits; one with them, as here, carries
    as much at a quarter more baud."""
    shot = shoot(
        "uart", tmp_path, own_domain_id, COUNT, 200, LENGTH, baud=921_600 * 10 // 8, txbuf=2048
    )
    assert shot.pictures == EXPECTED
    assert (shot.refused, shot.dropped, shot.sessions) == (0, 0, 1)
    print(f"\n{shot.rate:.2f} Hz, line {shot.busy:.1%} busy, high water {shot.heap.peak} bytes")
    assert shot.octets < (COUNT - 1) * LENGTH * OVERHEAD
    assert shot.heap.peak < HIGH_WATER
