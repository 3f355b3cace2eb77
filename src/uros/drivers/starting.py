"""Start-up of a part that may fail, without ending the program."""

import time

try:
    from sys import print_exception  # type: ignore[attr-defined,unused-ignore]
except ImportError:  # CPython
    from traceback import print_exception  # type: ignore[import-not-found,no-redef,unused-ignore]

try:
    from typing import Any, Callable, Final
except ImportError:
    pass

_BLINK_S: Final = 0.1
_BLINKS: Final = 10


def attempt(build: "Callable[[], Any]", signal: "Any" = None) -> "Any":
    """Call ``build()``, and report its exception instead of raising it.

    Args:
        build: Makes the part.
        signal: Blinks for a second after an exception, see `uros.drivers.led.Signal`.

    Returns:
        The result of ``build()``; None after an exception, which is printed: try again.
    """
    try:
        return build()
    except Exception as error:
        print_exception(error)
    for _ in range(_BLINKS):
        if signal is not None:
            signal.show(False)
        time.sleep(_BLINK_S)
    return None
