"""Interrupts: what the firmware wants to be called at edges of pins.

They are due at a moment of the board's time, and carried out when the firmware next looks at the
time, at a pin, or waits. Until the handler returns the board's time is the moment of the edge, so
that a handler that takes the time gets what it would in the interrupt itself.
"""

import _board  # type: ignore[import-not-found]

handlers: "dict[int, tuple[object, object]]" = {}  # number of the pin: handler, pin
_running = False


def run() -> None:
    """Carry out what is due. To be called only where there are handlers."""
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
