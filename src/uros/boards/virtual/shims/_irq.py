"""Pin interrupts: the handlers that the firmware registers for edges of pins.

An interrupt is due at the time of its edge. Its handler runs when the firmware next reads the time
or a pin, or waits. Until the handler returns, the board's time is that of the edge, so that a
handler that reads the time gets the time of the interrupt.
"""

import _board  # type: ignore[import-not-found]

handlers: "dict[int, tuple[object, object]]" = {}  # number of the pin: handler, pin
_running = False


def run() -> None:
    """Run the handlers that are due. Call it only where there are handlers."""
    global _running
    if _running:
        return
    _running = True
    try:
        while True:
            due = _board.number(_board.IRQ_NEXT)
            if not due:
                return
            entry = handlers.get(due >> 1)
            if entry is not None:
                entry[0](entry[1])  # type: ignore[operator]
    finally:
        _running = False
