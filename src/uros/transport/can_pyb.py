"""The port of a board's program whose CAN FD controller is a ``pyb.CAN``: STM32H7 and its like.

    can = CAN(1, CAN.NORMAL, baudrate=500000, brs_baudrate=2000000, sample_point=80)
    transport = CanTransport(PybCan(can), 0x201)

Runs on MicroPython. Controllers without FD have no room for a message in a frame.
"""

import errno

try:
    from typing import Any

    from ..wire.cdr import Buffer
except ImportError:  # MicroPython
    pass


class PybCan:
    """For a :class:`~.can.CanTransport`; no call waits.

    ``can`` is set up for NORMAL mode. ``can_id``, where given, is the only one that the controller
    lets through, which spares a program on a busy bus the frames of others. ``brs`` says whether
    data travel at the faster rate. Raises ValueError for a controller without FD.
    """

    def __init__(
        self, can: "Any", can_id: "int | None" = None, brs: bool = True, fifo: int = 0
    ) -> None:
        if not hasattr(can, "RANGE"):  # which filters of FD controllers have
            raise ValueError("this CAN controller has no CAN FD, which messages of uros need")
        self._can = can
        self._id = can_id
        self._brs = brs
        self._fifo = fifo

    def open(self) -> None:
        """Raises OSError where the bus does not work."""
        can = self._can
        if self._id is None:
            can.setfilter(0, can.MASK, self._fifo, (0, 0), extframe=True)
        else:
            can.setfilter(0, can.MASK, self._fifo, (self._id, 0x1FFFFFFF), extframe=True)
        if can.state() == can.BUS_OFF:
            can.restart()
        if can.state() in (can.STOPPED, can.BUS_OFF):
            self._off()

    def _off(self) -> None:
        raise OSError(
            errno.EIO,
            "the CAN bus is off: check its wires, its two resistors, and that all use the same"
            " bit rates",
        )

    def send(self, can_id: int, data: "Buffer") -> bool:
        """See :class:`~.can.Port`."""
        can = self._can
        try:
            can.send(data, can_id, timeout=0, extframe=True, fdf=True, brs=self._brs)
        except OSError:
            if can.state() == can.BUS_OFF:
                self._off()
            return False
        return True

    def recv(self) -> "tuple[int, Buffer] | None":
        """See :class:`~.can.Port`."""
        can = self._can
        while can.any(self._fifo):
            can_id, extended, remote, _, data = can.recv(self._fifo, timeout=0)
            if extended and not remote:
                return can_id, data
        return None
