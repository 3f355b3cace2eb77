"""The NMEA 0183 receiver. Also runs on MicroPython.

The sentences are written by hand after the standard and receivers' manuals; line() adds checksums.
"""

from uros.drivers.nmea import FIX, GBAS_FIX, NMEA, NO_FIX, SBAS_FIX, days, fixed


def line(body):
    total = 0
    for octet in body.encode():
        total ^= octet
    return ("$%s*%02X\r\n" % (body, total)).encode()


GGA = "GNGGA,092725.25,4717.1139912,N,00833.9159012,W,1,08,1.01,499.6,M,48.0,M,,"
RMC = "GNRMC,092725.25,A,4717.1139912,N,00833.9159012,W,1.944,77.52,091202,,,A,V"
GSA = "GNGSA,A,3,23,29,07,08,09,18,26,28,,,,,1.94,1.18,1.54,1"
NONE = line("GNRMC,,V,,,,,,,,,,N,V") + line("GNGGA,,,,,,0,00,99.99,,,,,,")


def near(a, b, by=0.0005):
    assert abs(a - b) < by, (a, b)


def test_a_published_checksum():
    """An example of many manuals, with its checksum."""
    data = b"$GPGGA,123519,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,*47\r\n"
    assert line(data[1:-5].decode()) == data
    receiver = NMEA()
    assert receiver.feed(data) is False
    assert (receiver.sentences, receiver.altitude) == (1, 0.0)
    assert receiver.feed(line("GPRMC,123519,A,4807.038,N,01131.000,E,022.4,084.4,230394,003.1,W"))
    near(receiver.altitude, 592.3, 0.001)
    assert (receiver.latitude_degrees, receiver.latitude_nano) == (48, 117300000)
    assert (receiver.longitude_degrees, receiver.longitude_nano) == (11, 516666667)


def test_a_position_is_complete_with_both_sentences():
    receiver = NMEA()
    assert receiver.feed(line(RMC)) is False
    assert receiver.status == NO_FIX
    assert receiver.feed(line(GGA)) is True
    assert receiver.status == FIX
    assert receiver.service == 1
    assert receiver.satellites == 8
    near(receiver.altitude, 547.6, 0.001)
    near(receiver.hdop, 1.01)
    near(receiver.speed, 1.0001)
    near(receiver.course, 77.52)
    # In the other order.
    assert receiver.feed(line(GGA)) is False
    assert receiver.feed(line(RMC)) is True
    assert receiver.feed(line(GSA)) is False
    near(receiver.vdop, 1.54)
    assert (receiver.sentences, receiver.damaged) == (5, 0)


def test_every_digit_survives():
    """47 + 17.1139912 / 60 = 47.28523318666..., to 1e-9."""
    receiver = NMEA()
    receiver.feed(line(RMC) + line(GGA))
    assert (receiver.latitude_degrees, receiver.latitude_nano) == (47, 285233187)
    assert (receiver.longitude_degrees, receiver.longitude_nano) == (-8, -565265020)
    if float("1.000000001") != 1.0:  # doubles
        near(receiver.latitude, 47.285233187, 1e-9)
        near(receiver.longitude, -8.565265020, 1e-9)
    else:
        near(receiver.latitude, 47.285233187, 4e-6)


def test_south_of_the_equator_by_less_than_a_degree():
    receiver = NMEA()
    replacement = ("4717.1139912,N", "0000.6,S")
    assert receiver.feed(line(RMC.replace(*replacement)) + line(GGA.replace(*replacement))) is True
    assert (receiver.latitude_degrees, receiver.latitude_nano) == (0, -10000000)
    near(receiver.latitude, -0.01, 1e-6)


def test_time_has_seconds_and_nanoseconds():
    receiver = NMEA()
    receiver.feed(line(RMC))
    # 9 December 2002, 09:27:25.25
    assert (receiver.seconds, receiver.nanosec) == (1039426045, 250000000)
    assert days(1970, 1, 1) == 0
    assert days(2000, 2, 29) == 11016
    assert days(2000, 3, 1) == 11017
    assert days(2026, 6, 1) * 86400 == 1780272000
    receiver.feed(line(RMC.replace("092725.25", "235960").replace("091202", "311216")))
    assert (receiver.seconds, receiver.nanosec) == (1483228800, 0)  # a leap second


def test_a_time_before_the_receivers_clock_is_set_is_ignored():
    receiver = NMEA()
    receiver.feed(line(RMC.replace("091202", "060180")))
    assert (receiver.seconds, receiver.nanosec) == (0, 0)
    receiver.feed(line(RMC))
    assert receiver.seconds
    receiver.feed(NONE)
    assert receiver.seconds == 0


def test_a_lost_fix_is_reported():
    receiver = NMEA()
    assert receiver.feed(NONE) is True
    assert receiver.status == NO_FIX
    receiver.feed(line(RMC) + line(GGA))
    assert receiver.status == FIX
    latitude = receiver.latitude
    assert receiver.feed(NONE) is True
    assert (receiver.status, receiver.service) == (NO_FIX, 0)
    assert receiver.latitude == latitude
    # A position with the warning flag V is no fix.
    assert receiver.feed(line(RMC.replace(",A,", ",V,", 1)) + line(GGA)) is True
    assert receiver.status == NO_FIX


def test_the_quality_determines_the_status():
    for quality, status in (
        (0, NO_FIX), (1, FIX), (2, SBAS_FIX), (3, FIX), (4, GBAS_FIX), (5, GBAS_FIX),
        (6, NO_FIX), (7, NO_FIX), (8, NO_FIX), (9, NO_FIX),
    ):  # fmt: skip
        receiver = NMEA()
        assert receiver.feed(line(RMC) + line(GGA.replace(",W,1,", ",W,%d," % quality)))
        assert receiver.status == status, quality


def test_the_talkers_determine_the_service():
    receiver = NMEA()
    for system in (1, 2, 3, 4):
        receiver.feed(line(GSA[:-1] + str(system)))
    receiver.feed(line(RMC) + line(GGA))
    assert receiver.service == 1 | 2 | 8 | 4
    receiver.feed(line(RMC) + line(GGA))  # no GSA since
    assert receiver.service == 1
    receiver = NMEA()
    receiver.feed(line("GLGSA" + GSA[5:-2]) + line("GL" + RMC[2:]) + line("GL" + GGA[2:]))
    assert receiver.service == 2


def test_sentences_of_two_times_are_not_combined():
    receiver = NMEA()
    assert receiver.feed(line(RMC)) is False
    assert receiver.feed(line(GGA.replace("092725.25", "092726.25"))) is False
    assert receiver.feed(line(RMC.replace("092725.25", "092726.25"))) is True


def test_sentences_that_disagree_are_damaged():
    """The checksum, an exclusive or, does not detect the same bit changed twice."""
    for latitude in ("4717.1159912", "4718.1139912", "4817.1139912"):
        receiver = NMEA()
        assert receiver.feed(line(RMC) + line(GGA.replace("4717.1139912", latitude))) is False
        assert (receiver.damaged, receiver.latitude_degrees, receiver.status) == (1, 0, NO_FIX)
        assert receiver.feed(line(RMC) + line(GGA)) is True
    # Some receivers send fewer digits in RMC.
    assert receiver.feed(line(RMC.replace("4717.1139912", "4717.11")) + line(GGA)) is False
    assert receiver.feed(line(RMC.replace("4717.1139912", "4717.114")) + line(GGA)) is True
    # At a whole degree, too.
    receiver = NMEA()
    assert receiver.feed(
        line(RMC.replace("4717.1139912", "4700.0000"))
        + line(GGA.replace("4717.1139912", "4659.9999990"))
    )


def test_sentences_in_pieces():
    data = line(RMC) + line(GSA) + line(GGA)
    receiver = NMEA()
    assert [receiver.feed(bytes((octet,))) for octet in data].count(True) == 1
    receiver = NMEA()
    assert receiver.feed(memoryview(data)[:50]) is False
    assert receiver.feed(bytearray(data[50:])) is True


def test_damaged_sentences_are_counted_and_ignored():
    good = line(RMC) + line(GGA)
    for bad in (
        line(GGA).replace(b"4717", b"4718"),  # the checksum is wrong
        line(GGA)[:-5] + b"\r\n",  # without a checksum
        line(GGA).replace(b"*", b"+"),
        b"$*00\r\n",
        b"$\r\n",
        b"$GNGGA\xff\r\n",
        line(GGA.replace("4717.1139912", "4760.0000000")),
        line(GGA.replace("4717.1139912", "9100.0000000")),
        line(GGA.replace("4717.1139912", "9000.0000100")),
        line(GGA.replace("4717.1139912", "-717.1139912")),
        line(GGA.replace("4717.1139912", "")),
        line(GGA.replace(",N,", ",E,")),
        line(GGA.replace(",N,", ",,")),
        line(GGA.replace(",W,", ",NS,")),
        line(GGA.replace("00833.9159012", "18000.0000100")),
        line(GGA.replace("092725.25", "242725.25")),
        line(GGA.replace("092725.25", "096025.25")),
        line(GGA.replace("092725.25", "092761.00")),
        line(GGA.replace("1.01", "1.x1")),
        line(GGA.replace("499.6", "")),
        line(GGA.replace(",W,1,", ",W,,")),
        line("GNGGA,092725.25,4717.1"),
        line(RMC.replace(",A,", ",,", 1)),
        line(RMC.replace("091202", "321202")),
        line(RMC.replace("091202", "091302")),
        line(RMC.replace("091202", "0912")),
        line(RMC.replace("091202", "09-202")),
        line("GNGSA,A,3"),
        b"$GNGGA,0927$",
        b"$" + b"A" * 200 + b"\r\n",
    ):
        receiver = NMEA()
        receiver.feed(good)
        before = (
            receiver.latitude_nano, receiver.longitude_nano, receiver.seconds, receiver.hdop,
            receiver.altitude, receiver.status, receiver.sentences,
        )  # fmt: skip
        assert receiver.feed(bad) is False, bad
        assert receiver.damaged == 1, (bad, receiver.damaged)
        assert before == (
            receiver.latitude_nano, receiver.longitude_nano, receiver.seconds, receiver.hdop,
            receiver.altitude, receiver.status, receiver.sentences,
        ), bad  # fmt: skip
        assert receiver.feed(good) is True, bad


def test_other_sentences_are_skipped():
    receiver = NMEA()
    more = line("GPTXT,01,01,02,hello") + line("PUBX,00,1") + line("GPVTG,77.52,T,,M,0.004,N")
    assert receiver.feed(b"noise \x00\xff\r\n" + more + b"\r\n\r\n") is False
    assert (receiver.sentences, receiver.damaged) == (0, 0)


def test_covariance_from_the_dilutions():
    receiver = NMEA(uere_m=4.0)
    out = [1.0] * 9
    receiver.covariance(out)
    assert out == [0.0] * 9
    receiver.feed(line(RMC) + line(GGA))
    receiver.covariance(out)
    # (1.01 * 4) ** 2 / 2; up: twice 1.01 without a VDOP; more with 32-bit floats.
    assert 8.1607 < out[0] < 8.41 and out[4] == out[0]
    near(out[8], 65.2864, 0.001)
    assert [out[i] for i in (1, 2, 3, 5, 6, 7)] == [0.0] * 6
    receiver.feed(line(GSA))
    receiver.covariance(out)
    near(out[8], 37.9456, 0.001)
    receiver.feed(NONE)
    receiver.covariance(out)
    assert out == [0.0] * 9


def test_fixed_point_numbers():
    assert fixed("12.3456", 3) == 12345
    assert fixed("-0.5", 2) == -50
    assert fixed("7", 2) == 700
    assert fixed(".5", 1) == 5
    for bad in ("", ".", "-", "1.2.3", "1e3", "+1", " 1", "0x1", "1_0", "--1"):
        try:
            fixed(bad, 0)
        except ValueError:
            pass
        else:
            raise AssertionError(bad)
