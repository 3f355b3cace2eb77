"""NMEA 0183: position, velocity and time from a GNSS receiver on a serial line.

    receiver = NMEA()
    data = uart.read(64)
    if data and receiver.feed(data):
        print(receiver.latitude, receiver.longitude)

Nothing here waits or raises: damaged sentences are counted and dropped. GGA, RMC and GSA of any
talker are used; others are skipped.

Numbers are kept as integers. An angle is whole degrees and billionths of a degree,
so that ``latitude`` and ``longitude`` have all the digits that the receiver sent where floats are
doubles. Where they have 32 bits, as on most boards, the float is rounded by 0.85 m at worst (above
128 degrees), and `covariance` counts that in; the two integers are exact there, too. This publishes
them with all digits (see `uros.client.float64`)::

    nano = receiver.latitude_degrees * 1000000000 + receiver.latitude_nano
    publisher.publish(Exact(fix, latitude=Float64(nano, 1000000000)))
"""

try:
    from typing import Final
except ImportError:
    pass

# Attack: a line that never ends. The standard allows 82 characters, some receivers send more.
_LONGEST: Final = 120
_NANO: Final = 1000000000
# Whether floats have 32 bits. Determined at run time: the host that compiles this for a board has
# doubles.
_SINGLE = float("1.000000001") == 1.0
_METRES: Final = 111320.0  # per degree
# By how many billionths of a degree the positions of RMC and GGA may differ: 2 m.
_APART: Final = 20000

NO_FIX: Final = -1
FIX: Final = 0
SBAS_FIX: Final = 1
GBAS_FIX: Final = 2
# GGA's quality as a status of sensor_msgs/NavSatStatus: none, autonomous, differential, (precise),
# RTK fixed, RTK float. Higher ones are estimated, manual or simulated.
_STATUS: Final = (NO_FIX, FIX, SBAS_FIX, FIX, GBAS_FIX, GBAS_FIX)
# Talker id of a sentence to the satellite system, as a service of NavSatStatus.
_SERVICES: Final = {"GP": 1, "GL": 2, "GB": 4, "BD": 4, "GA": 8}
# The same by the system id, the last field of GSA from version 4.10 of the standard on.
_SYSTEMS: Final = (0, 1, 2, 8, 4)


def days(year: int, month: int, day: int) -> int:
    """Return the days since 1 January 1970, by the Gregorian calendar."""
    if month < 3:
        year -= 1
        month += 12
    return (
        365 * year + year // 4 - year // 100 + year // 400 + (153 * month - 457) // 5 + day - 719469
    )


def fixed(text: str, decimals: int) -> int:
    """Return a decimal number times ten to the power of ``decimals``; more digits are cut off.

    Raises:
        ValueError: The text is no decimal number.
    """
    negative = text[:1] == "-"
    if negative:
        text = text[1:]
    whole, _, fraction = text.partition(".")
    if not (whole + fraction).isdigit():
        raise ValueError(text)
    value = int(whole + (fraction + "0" * decimals)[:decimals] or "0")
    return -value if negative else value


class NMEA:
    """A GNSS receiver's last valid data.

    A position is accepted when the GGA and the RMC of the same time agree on it: the checksum alone
    does not detect every damage.

    ``status`` is NO_FIX, FIX, SBAS_FIX or GBAS_FIX and ``service`` the satellite systems in use,
    both as in sensor_msgs/NavSatStatus; without a fix the position is that of the last one, or 0.
    ``latitude_degrees`` and ``latitude_nano`` have the same sign, as those of the longitude.
    ``altitude`` is in m above the ellipsoid of WGS 84, ``speed`` in m/s, ``course`` in degrees
    clockwise from north. ``seconds`` since 1970 and ``nanosec`` are UTC; 0 seconds: not known yet.
    ``sentences`` counts the accepted sentences, ``damaged`` the dropped ones.

    Args:
        uere_m: User equivalent range error of one satellite in metres, one sigma; receivers report
            only the dilution of precision, by which it is multiplied.
    """

    def __init__(self, uere_m: float = 3.0) -> None:
        self.status = NO_FIX
        self.service = 0
        self.satellites = 0
        self.latitude_degrees = self.latitude_nano = 0
        self.longitude_degrees = self.longitude_nano = 0
        self.altitude = 0.0
        self.hdop = self.vdop = 0.0  # 0: unknown
        self.speed = self.course = 0.0
        self.seconds = self.nanosec = 0
        self.sentences = 0
        self.damaged = 0
        self._uere = uere_m
        self._line = bytearray(_LONGEST)
        self._size = -1  # of the line; -1: its $ has not come
        # Time of day of the last GGA and RMC in ms; -1: empty, None: not received yet.
        self._gga: "int | None" = None
        self._rmc: "int | None" = None
        self._quality = NO_FIX
        self._valid = False
        self._systems = 0
        self._place: "tuple[int, ...] | None" = None  # of GGA
        self._rmc_place: "tuple[int, ...] | None" = None  # of RMC

    @property
    def latitude(self) -> float:
        """Degrees, north is positive."""
        return self.latitude_degrees + self.latitude_nano / _NANO

    @property
    def longitude(self) -> float:
        """Degrees, east is positive."""
        return self.longitude_degrees + self.longitude_nano / _NANO

    def feed(self, data: "bytes | bytearray | memoryview") -> bool:
        """Process received bytes.

        Returns:
            Whether they completed a GGA and an RMC of the same time: a position, or the state that
            there is none.
        """
        complete = False
        for octet in data:
            if octet == 0x24:
                if self._size >= 0:
                    self.damaged += 1
                self._size = 0
            elif self._size < 0:
                pass
            elif octet == 0x0D or octet == 0x0A:
                if self._take():
                    complete = True
                self._size = -1
            elif 0x20 <= octet < 0x7F and self._size < _LONGEST:
                self._line[self._size] = octet
                self._size += 1
            else:
                self.damaged += 1
                self._size = -1
        return complete

    def covariance(self, into: "list[float]") -> None:
        """Fill the 9 numbers of the position's covariance: east, north and up, in m².

        It follows from the dilutions of precision; without a fix, all are 0.
        """
        level = up = 0.0
        if self.status >= 0 and self.hdop:
            level = (self.hdop * self._uere) ** 2 / 2
            up = ((self.vdop or 2 * self.hdop) * self._uere) ** 2
            if _SINGLE:  # uniform rounding error of half a step: 2**-17 degrees above 128
                level += (_METRES * 2**-17) ** 2 / 3
        index = 0
        while index < 9:
            into[index] = 0.0
            index += 1
        into[0] = into[4] = level
        into[8] = up

    # --- sentences ----------------------------------------------------------------------------

    def _take(self) -> bool:
        size = self._size
        line = self._line
        total = 0
        index = 0
        while index < size - 3:
            total ^= line[index]
            index += 1
        try:
            if size < 9 or line[size - 3] != 0x2A:
                raise ValueError
            text = bytes(line[:size]).decode()
            if int(text[size - 2 :], 16) != total:
                raise ValueError
            fields = text[: size - 3].split(",")
            kind = fields[0][2:]
            if fields[0][0] == "P":
                return False  # proprietary
            if kind == "GGA":
                self._take_gga(fields)
            elif kind == "RMC":
                self._take_rmc(fields)
            elif kind == "GSA":
                self._take_gsa(fields)
            else:
                return False
        except (ValueError, IndexError):
            self.damaged += 1
            return False
        self.sentences += 1
        return self._complete()

    def _complete(self) -> bool:
        if self._gga is None or self._gga != self._rmc:
            return False
        self._gga = self._rmc = None
        place = self._place
        if place is not None:
            # The checksum does not detect every damage: compare the positions of both sentences.
            rmc_place = self._rmc_place
            if rmc_place is not None and (
                _apart(place[0], rmc_place[0], place[1], rmc_place[1])
                or _apart(place[2], rmc_place[2], place[3], rmc_place[3])
            ):
                self.damaged += 1
                return False
            self.latitude_degrees, self.latitude_nano = place[0], place[1]
            self.longitude_degrees, self.longitude_nano = place[2], place[3]
            self.hdop = place[4] / 100
            self.altitude = place[5] / 1000
        self.status = self._quality if self._valid else NO_FIX
        return True

    def _take_gga(self, fields: "list[str]") -> None:
        when = _moment(fields[1])
        quality = fixed(fields[6], 0)
        status = _STATUS[quality] if 0 <= quality < len(_STATUS) else NO_FIX
        place = None
        satellites = fixed(fields[7], 0) if fields[7] else 0
        if status >= 0:
            latitude = _angle(fields[2], fields[3], "NS", 90)
            longitude = _angle(fields[4], fields[5], "EW", 180)
            hdop = fixed(fields[8], 2)
            millimetres = fixed(fields[9], 3)
            if fields[11]:  # geoid separation: the sea above the ellipsoid
                millimetres += fixed(fields[11], 3)
            place = latitude + longitude + (hdop, millimetres)
        self._place = place
        self._quality = status
        self.satellites = satellites
        self.service = self._systems or _SERVICES.get(fields[0][:2], 1) if status >= 0 else 0
        self._systems = 0
        self._gga = -1 if when is None else when

    def _take_rmc(self, fields: "list[str]") -> None:
        when = _moment(fields[1])
        date = fields[9]
        valid = fields[2] == "A"
        if fields[2] not in ("A", "V"):
            raise ValueError
        speed = fixed(fields[7], 3) if fields[7] else 0
        course = fixed(fields[8], 2) if fields[8] else 0
        seconds = 0
        if date and when is not None:
            if len(date) != 6 or not date.isdigit():
                raise ValueError
            day, month, year = int(date[:2]), int(date[2:4]), int(date[4:])
            if not (1 <= day <= 31 and 1 <= month <= 12):
                raise ValueError
            # Receivers that do not know the date yet send one in 1980.
            if year < 80:
                seconds = days(2000 + year, month, day) * 86400 + when // 1000
        place = None
        if valid and fields[3]:
            place = _angle(fields[3], fields[4], "NS", 90) + _angle(fields[5], fields[6], "EW", 180)
        self._rmc_place = place
        self._valid = valid
        self.speed = speed * 1852 / 3600000
        self.course = course / 100
        self.seconds = seconds
        self.nanosec = when % 1000 * 1000000 if seconds and when is not None else 0
        self._rmc = -1 if when is None else when

    def _take_gsa(self, fields: "list[str]") -> None:
        vdop = fixed(fields[17], 2) if fields[17] else 0
        service = _SERVICES.get(fields[0][:2], 0)
        if len(fields) > 18:
            system = fixed(fields[18], 0)
            service = _SYSTEMS[system] if 0 <= system < len(_SYSTEMS) else 0
        if "".join(fields[3:15]):
            self._systems |= service
        self.vdop = vdop / 100 if vdop < 9999 else 0.0


def _apart(a: int, b: int, a_nano: int, b_nano: int) -> bool:
    """Return whether two angles differ by more than _APART."""
    return not (-2 < a - b < 2) or abs((a - b) * _NANO + a_nano - b_nano) > _APART


def _moment(text: str) -> "int | None":
    """Return ``hhmmss.sss`` in ms of the day; None if empty. A leap second is the 60th."""
    if not text:
        return None
    value = fixed(text, 3)
    hours, minutes, ms = value // 10000000, value // 100000 % 100, value % 100000
    if value < 0 or hours > 23 or minutes > 59 or ms > 60999:
        raise ValueError
    return (hours * 60 + minutes) * 60000 + ms


def _angle(text: str, side: str, sides: str, most: int) -> "tuple[int, int]":
    """Return degrees and billionths of a degree of ``dddmm.mmmmm`` and a letter."""
    # Units of 1e-7 minutes, the resolution of the best receivers: 600 million are a degree.
    value = fixed(text, 7)
    degrees, units = value // 1000000000, value % 1000000000
    if len(side) != 1 or side not in sides or value < 0 or units >= 600000000:
        raise ValueError
    nano = (units * 5 + 1) // 3
    if degrees + (nano > 0) > most:
        raise ValueError
    if side == sides[1]:
        return -degrees, -nano
    return degrees, nano
