"""Sends the values of three I2C sensors as text over USB, once a second. See README.md."""

import time

from uros.drivers import SensorError, reason
from uros.drivers.bus import Bus
from uros.drivers.mcp9600 import MCP9600
from uros.drivers.port import open_port
from uros.drivers.sht3x import SHT3x
from uros.drivers.vcnl4010 import LUX_PER_COUNT, VCNL4010

try:
    from typing import Any
except ImportError:
    pass

PERIOD_MS = 1000
LEAD_MS = 500  # the measurements begin this long before their line is due
LONGEST_MS = 50  # longest wait of one step
POLL_MS = 5  # period at which the VCNL4010 and a missing host are polled
RETRY_MS = 1000
UNKNOWN = "--"
# Counts at 200 mA; between the two the state of the door does not change.
CLOSED_FROM = 30000
OPENED_BELOW = 20000

program: "Any" = None
failed_at = 0


class RoomText:
    """Sends the values of the sensors on ``bus`` to ``port``; `step` does the work that is due.

    ``missed`` counts lines dropped for lack of time, ``skipped`` those that the host did not read.
    """

    def __init__(self, bus: "Any", port: "Any", now: int) -> None:
        self.port = port
        self.missed = 0
        self.skipped = 0
        self.sht3x = SHT3x(bus)
        self.mcp9600 = MCP9600(bus)
        self.vcnl4010 = VCNL4010(bus)
        self.due = time.ticks_add(now, PERIOD_MS)
        self.closed = False
        self.failing: "dict[str, str]" = {}
        self._pending = b""  # the current line, of which _sent bytes are sent
        self._sent = 0
        # The current cycle: its start, and the readings that are missing.
        self._measuring = False
        self._began = 0
        self._climate_due = False
        self._light_due = False
        self._forget()

    def step(self, now: int) -> int:
        """Do the work due at ``now`` in ticks_ms; return the milliseconds until the next work."""
        self._serve()
        left = time.ticks_diff(self.due, now)
        if left <= 0:
            self._tell()
            self.due = time.ticks_add(self.due, PERIOD_MS)
            while time.ticks_diff(self.due, now) <= 0:
                self.missed += 1
                self.due = time.ticks_add(self.due, PERIOD_MS)
            return 0
        if not self._measuring:
            if left > LEAD_MS:
                return left - LEAD_MS
            self._measure(now)
            return 0
        age = time.ticks_diff(now, self._began)
        if self._climate_due and age >= SHT3x.wait_ms:
            self._climate_due = False
            self._try("SHT3x", self._read_climate)
        if self._light_due and age >= VCNL4010.wait_ms:
            self._light_due = self._try("VCNL4010", self._read_light) and self._lux == UNKNOWN
        if self._climate_due:
            left = min(left, SHT3x.wait_ms - age)
        elif self._light_due:
            left = min(left, max(VCNL4010.wait_ms - age, POLL_MS))
        return left

    # Measurement.

    def _forget(self) -> None:
        self._room = self._hot = self._cold = self._humidity = self._door = self._lux = UNKNOWN
        self._measuring = self._climate_due = self._light_due = False

    def _measure(self, now: int) -> None:
        self._forget()
        self._measuring = True
        self._began = time.ticks_add(now, 1)  # this millisecond may be nearly over
        self._climate_due = self._try("SHT3x", self.sht3x.start)
        self._light_due = self._try("VCNL4010", self.vcnl4010.start)
        self._try("MCP9600", self._read_thermocouple)

    def _try(self, name: str, action: "Any") -> bool:
        """Run an action of a sensor, which returns True for a complete reading.

        Prints when a sensor begins to fail and when it works again. Returns whether the action
        succeeded.
        """
        try:
            complete = action()
        except (OSError, SensorError) as error:
            if name not in self.failing:
                print("%s read failed: %s" % (name, reason(error)))
            self.failing[name] = reason(error)
            return False
        if complete and name in self.failing:
            del self.failing[name]
            print("%s read again" % name)
        return True

    def _read_climate(self) -> bool:
        self.sht3x.read()
        self._room = both_units(self.sht3x.temperature)
        self._humidity = "%.0f%%" % (self.sht3x.humidity * 100)
        return True

    def _read_thermocouple(self) -> bool:
        hot = self.mcp9600.read_hot()
        self._cold = both_units(self.mcp9600.read_cold())
        self._hot = both_units(hot)
        return True

    def _read_light(self) -> bool:
        if not self.vcnl4010.read():
            return False
        threshold = OPENED_BELOW if self.closed else CLOSED_FROM
        self.closed = self.vcnl4010.proximity >= threshold
        self._door = "Closed" if self.closed else "Opened"
        self._lux = "%.0f" % (self.vcnl4010.ambient * LUX_PER_COUNT)
        return True

    # Output.

    def _tell(self) -> None:
        if self._light_due:
            self._try("VCNL4010", too_late)
        line = "Room: %s | Hot: %s | Cold: %s | Hum: %s | Door: %s | Lux: %s\r\n" % (
            self._room, self._hot, self._cold, self._humidity, self._door, self._lux,
        )  # fmt: skip
        self._forget()
        if self._sent < len(self._pending):
            self.skipped += 1  # an older line is sent in part, and is completed first
            return
        self._pending = line.encode()
        self._sent = 0
        self._serve()
        if not self._sent:
            self.skipped += 1
            self._pending = b""  # no host reads: the line is dropped, so none is late

    def _serve(self) -> None:
        """Send the rest of the line, and discard input."""
        try:
            while self.port.read(64):
                pass
            if self._sent < len(self._pending):
                self._sent += self.port.write(memoryview(self._pending)[self._sent :]) or 0
        except OSError:  # no host
            self._pending = b""
            self._sent = 0


def both_units(celsius: float) -> str:
    return "%.1fC|%.1fF" % (celsius, celsius * 1.8 + 32)


def too_late() -> None:
    raise SensorError("the measurement does not end")


def start() -> None:
    """Build everything without waiting. After a failure step() tries again."""
    global program, failed_at
    try:
        port = open_port(0x045B, 0x2013, "Renesas", "RA6M5 USB Text", "000001")
        program = RoomText(Bus(2, "P415"), port, time.ticks_ms())
    except Exception as error:
        print("%s %s" % (type(error).__name__, error))
        failed_at = time.ticks_ms()


def step() -> None:
    """Do one piece of work; waits at most 50 ms."""
    now = time.ticks_ms()
    if program is None:
        time.sleep_ms(LONGEST_MS)
        if time.ticks_diff(now, failed_at) >= RETRY_MS:
            start()
        return
    idle = min(program.step(now), LONGEST_MS)
    if idle > 0:
        port = program.port
        if not hasattr(port, "is_open"):
            time.sleep_ms(min(idle, POLL_MS))
        elif port.is_open():
            port.wait(idle)  # returns early when the host sends data
        else:
            time.sleep_ms(min(idle, POLL_MS))


def main() -> None:
    start()
    while True:
        step()


if __name__ == "__main__":
    main()
