"""System calls from the firmware to the virtual board.

``call(op, data=b"") -> bytes`` and ``number(op, data=b"") -> int`` (0 to 2^30 - 1, without
allocation) come from the engine, as the module ``_host``. Both block until the board has carried
out the operation, and raise OSError with the board's error number. ``_ops`` lists the operations.
"""

from _host import call, number  # type: ignore[import-not-found]  # noqa: F401
from _ops import *  # type: ignore[import-not-found]  # noqa: F403
