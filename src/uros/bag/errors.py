"""The error of bags."""

from __future__ import annotations


class BagError(RuntimeError):
    """A bag cannot be read or written. The text names the file, the fault and the remedy."""
