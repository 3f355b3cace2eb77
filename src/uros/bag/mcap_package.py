"""Whether this Python has the package mcap, and whether PyPI has wheels of what mcap needs."""

from __future__ import annotations

import platform
import sys
from typing import Final

# mcap is pure Python; it needs lz4 and zstandard, which both have wheels for CPython 3.10 to 3.14
# on these: (sys.platform, platform.machine()), on Linux with glibc. The markers in pyproject.toml
# say the same, but for glibc: there is no marker of the C library.
_WITH_WHEELS: Final = (
    ("linux", "x86_64"), ("linux", "aarch64"), ("darwin", "x86_64"), ("darwin", "arm64"),
    ("win32", "AMD64"),
)  # fmt: skip
_LAST_PYTHON: Final = (3, 14)
NOT_INSTALLED: Final = "the package mcap is not installed"


def why_missing() -> str:
    """Return why MCAP files cannot be used here; empty if they can."""
    try:
        import lz4.frame  # noqa: F401
        import mcap.records  # noqa: F401
        import zstandard  # noqa: F401
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] == "mcap":
            return NOT_INSTALLED
        return f"the package mcap cannot be loaded ({error})"
    except (ImportError, OSError) as error:
        return f"the package mcap cannot be loaded ({error})"
    return ""


def has_wheel() -> bool:
    """Return whether PyPI has wheels of mcap's requirements for this Python."""
    return (
        platform.python_implementation() == "CPython"
        and sys.version_info[:2] <= _LAST_PYTHON
        and (sys.platform, platform.machine()) in _WITH_WHEELS
        and not (sys.platform == "linux" and platform.libc_ver()[0] != "glibc")
    )


def remedy() -> str:
    """Return what a user who asks for MCAP can do where it is missing."""
    if has_wheel():
        return "python -m pip install 'mcap~=1.6', or use -s sqlite3, which needs no library"
    version = ".".join(map(str, sys.version_info[:2]))
    return (
        f"PyPI has no wheels of lz4 and zstandard, which it needs, for Python {version} on"
        f" {sys.platform} {platform.machine()}: use -s sqlite3, or install mcap with a compiler"
    )
