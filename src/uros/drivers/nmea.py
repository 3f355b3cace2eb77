"""NMEA 0183: where it is and when, from a receiver of satellites on a serial line.

    receiver = NMEA()
    data = uart.read(64)
    if data and receiver.feed(data):
        print(receiver.latitude, receiver.longitude)

Nothing here waits or raises: what comes damaged is counted and left out. Sentences are GGA, RMC and
GSA of any talker; others are skipped.

Numbers stay integers up to the last moment. An angle is whole degrees and billionths of a degree,
so that ``latitude`` and ``longitude`` have all the digits that the receiver sent where floats are
doubles. Where they have 32 bits, as on most boards, the float is rounded by 0.85 m at worst (above
128 degrees), and `covariance` counts that in; the two integers are exact there, too.
"""

try:
    from typing import Final
except ImportError:
    pass

# Attack: a line that never ends. The standard has 82 characters, some receivers say more.
_LONGEST: Final = 120
_NANO: Final = 1000000000
# Whether a float has no room for billionths beside 1. Asked for where it runs: what compiles it
# for a board has doubles.
_SINGLE = float("1.000000001") == 1.0
_METRES: Final = 111320.0  # of a degree
# By how many billionths of a degree the positions of RMC and GGA may differ: 2 m.
_APART: Final = 20000

NO_FIX: Final = -1
FIX: Final = 0
SBAS_FIX: Final = 1
GBAS_FIX: Final = 2
# What GGA's quality is as sensor_msgs/NavSatStatus has it: none, alone, differential, (precise),
# kinematic, kinematic that is still settling. Others are guessed, typed in or simulated.
_STATUS: Final = (NO_FIX, FIX, SBAS_FIX, FIX, GBAS_FIX, GBAS_FIX)
# What the first letters of a sentence say of who is heard, as NavSatStatus has it.
_SERVICES: Final = {"GP": 1, "GL": 2, "GB": 4, "BD": 4, "GA": 8}
# By the last field of GSA, from version 4.10 of the standard on.
_SYSTEMS: Final = (0, 1, 2, 8, 4)


def days(year: int, month: int, day: int) -> int:
    """From 1 January 1970 on, by the Gregorian calendar."""
    if month < 3:
        year -= 1
        month += 12
    return (
        365 * year + year // 4 - year // 100 + year // 400 + (153 * month - 457) // 5 + day - 719469
    )


def fixed(text: str, decimals: int) -> int:
    """A decimal number times ten to the power of ``decimals``; more digits are cut off. ValueError
    where it is none.
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
    """What the last good sentences said. A position counts when the GGA and the RMC of its moment
    agree on it: the checksum alone lets one damage in some through.

    ``status`` is NO_FIX, FIX, SBAS_FIX or GBAS_FIX and ``service`` who is heard, both as in
    sensor_msgs/NavSatStatus; without a fix the position is that of the last one, or 0.
    ``latitude_degrees`` and ``latitude_nano`` have the same sign, as those of the longitude.
    ``altitude`` is in m above the ellipsoid of WGS 84, ``speed`` in m/s, ``course`` in degrees
    clockwise from north. ``seconds`` since 1970 and ``nanosec`` are UTC; 0 seconds: the receiver
    does not know it yet. ``sentences`` counts those that were taken, ``damaged`` those that came
    damaged.

    ``uere_m`` is the error of one satellite's range, one sigma: the receiver says only how much
    worse the satellites' places in the sky make it.
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
        # What the sentences of one moment say of the time; -1: not, None: not yet.
        self._gga: "int | None" = None
        self._rmc: "int | None" = None
        self._quality = NO_FIX
        self._valid = False
        self._systems = 0
        self._place: "tuple[int, ...] | None" = None  # of GGA
        self._other: "tuple[int, ...] | None" = None  # of RMC: where it says that it is

    @property
    def latitude(self) -> float:
        """In degrees, north is positive."""
        return self.latitude_degrees + self.latitude_nano / _NANO

    @property
    def longitude(self) -> float:
        """In degrees, east is positive."""
        return self.longitude_degrees + self.longitude_nano / _NANO

    def feed(self, data: "bytes | bytearray | memoryview") -> bool:
        """What came on the line. Returns whether a position, or that there is none, is complete
        with it: a GGA and an RMC of one moment.
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
        """The position's, of 9 numbers: east, north and up in m², from the dilutions of precision.
        Without a fix, all 0.
        """
        level = up = 0.0
        if self.status >= 0 and self.hdop:
            level = (self.hdop * self._uere) ** 2 / 2
            up = ((self.vdop or 2 * self.hdop) * self._uere) ** 2
            if _SINGLE:  # an even error of half a step: 2**-17 degrees above 128
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
                return False  # of the maker's own
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
            # The checksum misses one damage in some: both sentences say where it is, so compare.
            other = self._other
            if other is not None and (
                _apart(place[0], other[0], place[1], other[1])
                or _apart(place[2], other[2], place[3], other[3])
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
            if fields[11]:  # from the ellipsoid to the sea
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
            # What receivers say that do not know it is in 1980, or later by some weeks.
            if year < 80:
                seconds = days(2000 + year, month, day) * 86400 + when // 1000
        other = None
        if valid and fields[3]:
            other = _angle(fields[3], fields[4], "NS", 90) + _angle(fields[5], fields[6], "EW", 180)
        self._other = other
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
    """Whether two angles differ by more than they may."""
    return not (-2 < a - b < 2) or abs((a - b) * _NANO + a_nano - b_nano) > _APART


def _moment(text: str) -> "int | None":
    """``hhmmss.sss`` in ms of the day; None: nothing is there. A leap second is the 60th."""
    if not text:
        return None
    value = fixed(text, 3)
    hours, minutes, ms = value // 10000000, value // 100000 % 100, value % 100000
    if value < 0 or hours > 23 or minutes > 59 or ms > 60999:
        raise ValueError
    return (hours * 60 + minutes) * 60000 + ms


def _angle(text: str, side: str, sides: str, most: int) -> "tuple[int, int]":
    """``dddmm.mmmmm`` and a letter: degrees and billionths of a degree."""
    # Of a minute 1e-7, the digits that the best receivers send: 600 million are a degree.
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
