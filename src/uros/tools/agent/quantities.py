"""Writes time spans and sizes as text."""

from __future__ import annotations


def duration(seconds: float) -> str:
    """Return a time span as ``0.1 s``, ``42 s``, ``3 min``, ``2 h 5 min`` or ``3 d 4 h``."""
    if seconds < 10:
        return f"{seconds:.1f} s"
    whole = int(seconds)
    if whole < 120:
        return f"{whole} s"
    if whole < 7200:
        return f"{whole // 60} min"
    if whole < 172_800:
        return f"{whole // 3600} h {whole % 3600 // 60} min"
    return f"{whole // 86_400} d {whole % 86_400 // 3600} h"


def octets(count: int) -> str:
    """Return a size as ``950 B``, ``12.3 kB`` or ``4.5 MB``."""
    if count < 1000:
        return f"{count} B"
    size = float(count)
    for unit in ("kB", "MB", "GB"):
        size /= 1000
        if size < 999.95:
            return f"{size:.1f} {unit}"
    return f"{size / 1000:.1f} TB"
