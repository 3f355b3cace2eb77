"""Starts the sub core apart from the main core, which therefore cannot delay a stop of the wheels.

On a virtual board the sub core is a second core with an interpreter of its own, elsewhere a thread,
which MicroPython has on the ESP32 and, on its second core, on the RP2040 and RP2350.
"""

from mail import Mailbox

try:
    from typing import Any
except ImportError:
    pass

_STACK = 8192  # octets, of the thread
_boxes: "Any" = None


def start_sub_core() -> "tuple[Any, Any]":
    """Start the sub core once; return the mailboxes to it and from it."""
    global _boxes
    if _boxes is None:
        _boxes = _start()
    return _boxes  # type: ignore[no-any-return]


def _start() -> "tuple[Any, Any]":
    try:
        import second_core  # type: ignore[import-not-found]
    except ImportError:
        import _thread

        import sub

        to_sub = Mailbox()
        from_sub = Mailbox()
        _thread.stack_size(_STACK)
        _thread.start_new_thread(sub.run, (to_sub, from_sub))
        return to_sub, from_sub
    second_core.start("sub")
    return second_core.Mailbox(second_core.TO_SECOND), second_core.Mailbox(second_core.TO_FIRST)
