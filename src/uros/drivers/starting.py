"""How a program starts that is not to end by an error on its way."""

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
    """What ``build()`` returns. Where it raises, the console gets the error, ``signal`` (see
    `uros.drivers.led.Signal`) blinks for a second, and None is returned: to be tried again.
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
