"""The GNSS receiver, and the driver that reads its sentences."""

import math
from datetime import datetime, timezone

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.examples import examples

from uros.boards.virtual.devices.gnss import Gnss, angle, sentence
from uros.boards.virtual.world.outdoors import Motion, Outdoors
from uros.drivers.nmea import FIX, NMEA, NO_FIX


class Bench:
    def __init__(self, seed=1, **options):
        self.world = Outdoors(seed)
        self.gnss = Gnss(self.world.place, self.world.epoch, seed=seed, **options)
        self.nmea = NMEA()
        self.t_us = 0
        self.fixes = []  # (seconds, status) of each complete report

    def run(self, seconds, every_us=10_000):
        out = bytearray()
        end = self.t_us + int(seconds * 1e6)
        while self.t_us < end:
            self.t_us += every_us
            self.gnss.advance(self.t_us)
            data = self.gnss.read(256)
            if data:
                out += data
                if self.nmea.feed(data):
                    self.fixes.append((self.t_us / 1e6, self.nmea.status))
        return bytes(out)

    def error_m(self):
        """Return the horizontal and vertical error against the place at the last second."""
        true = self.world.place(self.nmea.seconds - self.world.epoch)
        north = (self.nmea.latitude - true.latitude) * self.world.metres[0]
        east = (self.nmea.longitude - true.longitude) * self.world.metres[1]
        return math.hypot(north, east), self.nmea.altitude - true.altitude


def test_a_cold_start():
    bench = Bench()
    output = bench.run(5.5)
    assert b"TXT" in output and b"$GNRMC,,V," in output
    assert [status for _, status in bench.fixes] == [NO_FIX] * 4
    assert bench.nmea.seconds == 0
    assert bench.gnss.shows() == "no fix"
    bench.run(3)
    assert bench.nmea.seconds == bench.world.epoch + 8  # the time, and no position yet
    assert bench.nmea.status == NO_FIX
    bench.run(30)
    assert bench.nmea.status == FIX
    first = next(t for t, status in bench.fixes if status == FIX)
    assert 28 <= first < 29
    assert bench.nmea.damaged == 0
    assert "satellites" in bench.gnss.shows()


def test_a_position_a_second_near_the_true_one():
    bench = Bench(cold_start_s=2.0)
    bench.run(10)
    errors = []
    for _ in range(300):
        before = len(bench.fixes)
        bench.run(1)
        assert len(bench.fixes) == before + 1
        errors.append(bench.error_m())
        # From the reported second to its last octet; the line takes most of the time.
        age = bench.fixes[-1][0] % 1
        assert 0.15 < age < 0.3
    assert max(level for level, _ in errors) < 8
    assert max(abs(up) for _, up in errors) < 12
    assert bench.nmea.speed == pytest.approx(0.8, abs=0.01)
    covariance = [0.0] * 9
    bench.nmea.covariance(covariance)
    # The reported accuracy is not better than the true one.
    mean = sum(level * level for level, _ in errors) / len(errors)
    assert mean < covariance[0] + covariance[4]
    assert 1 < covariance[0] < 25 and covariance[8] > covariance[0]


def test_time_is_utc():
    bench = Bench(cold_start_s=2.0)
    output = bench.run(20).decode()
    when = datetime.fromtimestamp(bench.nmea.seconds, timezone.utc)
    assert f"GNRMC,{when:%H%M%S}.00,A," in output and f"{when:%d%m%y}" in output
    assert bench.nmea.seconds == bench.world.epoch + 19


def test_power_on_between_two_seconds():
    gnss = Gnss(lambda t: Motion(t, 0.0, 0.0, 0.0, 0.0), 1_000_000_000.75, cold_start_s=3.0)
    nmea = NMEA()
    for ms in range(0, 10_000, 10):
        gnss.advance(ms * 1000)
        if nmea.feed(gnss.read(256) or b"") and nmea.status == FIX:
            t = nmea.seconds - 1_000_000_000.75
            assert nmea.latitude == pytest.approx(t, abs=1e-3)
            assert t + 0.15 < ms / 1000 < t + 0.3
    assert nmea.seconds == 1_000_000_010


def test_the_line_has_960_octets_a_second():
    gnss = Gnss(Outdoors().place, 0, cold_start_s=0)
    gnss.advance(2_000_000)
    gnss.read(10_000)
    gnss.advance(2_060_000 + 52_084)  # 50 octets
    assert gnss.any() == 50
    assert len(gnss.read(20)) == 20
    assert len(gnss.read(100)) == 30
    assert gnss.read(100) is None
    assert gnss.write(b"$PUBX,40*00\r\n") == 13


def test_output_does_not_exceed_the_baud_rate():
    gnss = Gnss(Outdoors().place, 0, baud=1200, cold_start_s=0.0)
    count = 0
    for second in range(1, 21):
        gnss.advance(second * 1_000_000)
        count += len(gnss.read(10_000) or b"")
        assert count <= second * 120
    assert count > 19 * 100


def test_the_output_does_not_depend_on_when_it_is_read():
    a, b = Bench(seed=7), Bench(seed=7)
    often = a.run(60, every_us=1_000)
    seldom = b.run(60, every_us=97_000) + b.run(1)
    assert seldom.startswith(often) or often.startswith(seldom)
    assert len(often) > 9_000


def test_unread_data_is_lost_and_a_week_is_skipped():
    gnss = Gnss(Outdoors().place, 0)
    gnss.advance(7 * 86_400 * 1_000_000)
    output = b""
    while data := gnss.read(512):
        output += data
    assert 2_000 < len(output) <= 4_096
    nmea = NMEA()
    assert nmea.feed(output) and nmea.status == FIX and nmea.damaged == 0


def test_no_fix_and_a_new_fix():
    bench = Bench(cold_start_s=2.0)
    bench.run(20)
    bench.gnss.fault("nofix")
    bench.run(5)
    assert bench.nmea.status == NO_FIX
    assert bench.nmea.seconds == bench.world.epoch + 24
    bench.gnss.heal()
    bench.run(2)
    assert bench.nmea.status == NO_FIX
    bench.run(4)
    assert bench.nmea.status == FIX


def test_the_fault_silent_ends_the_output():
    bench = Bench(cold_start_s=2.0)
    bench.run(10)
    bench.gnss.fault("silent")
    assert bench.run(10) == b""
    bench.gnss.heal()
    bench.run(2)
    assert bench.nmea.status == FIX


def test_damaged_octets_never_make_a_wrong_position():
    bench = Bench(cold_start_s=2.0)
    bench.run(10)
    bench.gnss.fault("noise")
    fixes = 0
    for _ in range(400):
        before = len(bench.fixes)
        bench.run(1)
        if len(bench.fixes) > before:
            fixes += 1
            assert bench.error_m()[0] < 8
    assert bench.nmea.damaged > 200
    assert fixes > 50
    bench.gnss.heal()
    bench.run(2)
    assert bench.fixes[-1][1] == FIX


def test_jamming_increases_the_covariance():
    bench = Bench(cold_start_s=2.0)
    bench.run(20)
    calm = [0.0] * 9
    bench.nmea.covariance(calm)
    bench.gnss.fault("jam")
    jumps = []
    for _ in range(20):
        bench.run(1)
        jumps.append(bench.error_m()[0])
    wild = [0.0] * 9
    bench.nmea.covariance(wild)
    assert max(jumps) > 100
    assert wild[0] > 20 * calm[0]


def test_a_cold_restart():
    bench = Bench(cold_start_s=5.0)
    bench.run(20)
    bench.gnss.act("cold")
    bench.run(3)
    assert bench.nmea.status == NO_FIX and bench.nmea.seconds == 0
    bench.run(8)
    assert bench.nmea.status == FIX
    assert set(bench.gnss.FAULTS) == {"nofix", "noise", "silent", "jam"}
    assert set(bench.gnss.ACTS) == {"cold"}


def test_checksum_and_angles_of_sentences():
    """The GGA example of many manuals, and angles in degrees and minutes."""
    body = "GPGGA,123519,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,"
    assert sentence(body) == f"${body}*47\r\n".encode()
    assert angle(48.1173, 2, 3, "NS") == "4807.038,N"
    assert angle(-11.5166667, 3, 3, "EW") == "01131.000,W"
    # Rounding never makes 60 minutes.
    assert angle(7.99999999999, 2, 5, "NS") == "0800.00000,N"


@settings(deadline=None)
@given(
    st.floats(-90, 90), st.floats(-180, 180), st.floats(-500, 9000), st.integers(5, 7),
    st.integers(1_000_000_000, 2_147_000_000),
)  # fmt: skip
def test_every_place_and_time_round_trips(latitude, longitude, altitude, decimals, epoch):
    """The tolerance is half a unit of the last digit sent, and 1e-9."""
    by = 0.51 * 10**-decimals / 60 + 1e-9
    lines = b"".join(
        sentence(body)
        for body in (
            f"GPRMC,{datetime.fromtimestamp(epoch, timezone.utc):%H%M%S},A,"
            f"{angle(latitude, 2, decimals, 'NS')},{angle(longitude, 3, decimals, 'EW')},,,"
            f"{datetime.fromtimestamp(epoch, timezone.utc):%d%m%y},,,A",
            f"GPGGA,{datetime.fromtimestamp(epoch, timezone.utc):%H%M%S},"
            f"{angle(latitude, 2, decimals, 'NS')},{angle(longitude, 3, decimals, 'EW')},1,08,1.0,"
            f"{altitude:.2f},M,0.0,M,,",
        )
    )
    nmea = NMEA()
    assert nmea.feed(lines)
    assert abs(nmea.latitude - latitude) <= by
    assert abs(nmea.longitude - longitude) <= by
    assert nmea.altitude == pytest.approx(altitude, abs=0.006)
    assert nmea.seconds == epoch


@settings(max_examples=examples(300))
@given(
    st.lists(
        st.one_of(
            st.binary(max_size=100),
            st.text("$*,.0123456789AVNSEWGPRMCT-\r\n", max_size=90).map(str.encode),
            st.builds(
                lambda kind, fields: sentence(",".join([kind, *fields])),
                st.sampled_from(("GPGGA", "GNRMC", "GNGSA", "GP", "P", "")),
                st.lists(st.text("0123456789.-ANVSEW", max_size=12), max_size=20),
            ),
        ),
        max_size=12,
    )
)
def test_any_octets_on_the_line(pieces):
    nmea = NMEA()
    for piece in pieces:
        nmea.feed(piece)
        assert -90 <= nmea.latitude <= 90 and -180 <= nmea.longitude <= 180
        assert nmea.status in (-1, 0, 1, 2)
        assert nmea.seconds >= 0 and 0 <= nmea.nanosec < 10**9
        assert nmea.hdop >= 0 or nmea.damaged >= 0
        out = [0.0] * 9
        nmea.covariance(out)
        assert all(math.isfinite(value) and value >= 0 for value in out)
    # Undamaged sentences are still read.
    fine = sentence("GPRMC,120000,A,,,,,,,010126,,,A") + sentence(
        "GPGGA,120000,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,"
    )
    nmea.feed(b"\r\n")
    assert nmea.feed(fine) and nmea.status == FIX


def test_near_the_date_line():
    gnss = Gnss(lambda t: Motion(0.0, 179.9999999, 0.0, 0.0, 0.0), 10**9, cold_start_s=0.0)
    nmea = NMEA()
    for second in range(3, 200):
        gnss.advance(second * 1_000_000)
        nmea.feed(gnss.read(4096) or b"")
    assert nmea.damaged == 0
