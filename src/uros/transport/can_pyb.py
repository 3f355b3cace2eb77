"""Port of a :class:`~.can.CanTransport` on ``pyb.CAN`` with CAN FD, such as the STM32H7's.

    can = CAN(1, CAN.NORMAL, baudrate=500000, brs_baudrate=2000000, sample_point=80)
    transport = CanTransport(PybCan(can), 0x201)

Runs on MicroPython. Frames of controllers without FD are too short for messages.
"""

import errno

try:
    from typing import Any

    from ..wire.cdr import Buffer
except ImportError:  # MicroPython
    pass


class PybCan:
    """A CAN FD controller; no call waits.

    Args:
        can: A ``pyb.CAN`` in NORMAL mode.
        can_id: The only identifier that the controller's filter accepts; None accepts all.
        brs: Whether data are sent at the faster bit rate.
        fifo: The receive FIFO.

    Raises:
        ValueError: The controller has no CAN FD.
    """

    def __init__(
        self, can: "Any", can_id: "int | None" = None, brs: bool = True, fifo: int = 0
    ) -> None:
        if not hasattr(can, "RANGE"):  # a filter mode that only FD controllers have
            raise ValueError("this CAN controller has no CAN FD, which messages of uros need")
        self._can = can
        self._id = can_id
        self._brs = brs
        self._fifo = fifo

    def open(self) -> None:
        """Set the filter, and restart a bus that is off. Raises OSError if it stays off."""
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
