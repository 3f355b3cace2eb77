"""What the C++ agent calls CED: :mod:`.memory`, where every text is a name.

Its CED parses neither XML nor references. A participant's text means nothing, and a topic's is the
topic's name, by which datawriters and datareaders call it.
"""

from __future__ import annotations

from .memory import MemoryMiddleware


class CedMiddleware(MemoryMiddleware):
    """See the module."""

    name = "ced"
    any_name = True


def create() -> CedMiddleware:
    """A middleware on a bus of its own."""
    return CedMiddleware()
