"""What the C++ agent calls CED: :mod:`.memory` with any text as a name.

Its CED parses neither XML nor references. A participant's representation has no meaning, and a
topic's is the name of the topic, to which datawriters and datareaders refer.
"""

from __future__ import annotations

from .memory import MemoryMiddleware


class CedMiddleware(MemoryMiddleware):
    """The memory middleware with any text as a name."""

    name = "ced"
    any_name = True


def create() -> CedMiddleware:
    """Return a middleware on a bus of its own."""
    return CedMiddleware()
