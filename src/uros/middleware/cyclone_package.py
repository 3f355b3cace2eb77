"""Whether this Python has the package cyclonedds, and whether PyPI has a wheel of it."""

from __future__ import annotations

import platform
import sys
from typing import Final

# Of cyclonedds 11.0.1 there are wheels for CPython 3.10 to 3.13 on these: (sys.platform,
# platform.machine()), on Linux with glibc. The markers in pyproject.toml say the same, but for
# glibc: there is no marker of the C library.
_WITH_WHEELS: Final = (
    ("linux", "x86_64"), ("darwin", "x86_64"), ("darwin", "arm64"), ("win32", "AMD64"),
)  # fmt: skip
_LAST_PYTHON: Final = (3, 13)
NOT_INSTALLED: Final = "cyclonedds is not installed"


def why_missing() -> str:
    """Return why Cyclone cannot be used here; empty if it can."""
    try:
        import cyclonedds
        import cyclonedds.core  # noqa: F401  which loads the C library
    except ModuleNotFoundError as error:
        if error.name == "cyclonedds":
            return NOT_INSTALLED
        return f"cyclonedds cannot be loaded ({error})"
    except (ImportError, OSError) as error:
        return f"cyclonedds cannot be loaded ({error})"
    return ""


def has_wheel() -> bool:
    """Return whether PyPI has a wheel of cyclonedds for this Python."""
    return (
        platform.python_implementation() == "CPython"
        and sys.version_info[:2] <= _LAST_PYTHON
        and (sys.platform, platform.machine()) in _WITH_WHEELS
        and not is_linux_without_glibc()
    )


def is_linux_without_glibc() -> bool:
    """Return whether this is a Linux without glibc, such as Alpine, whose C library is musl."""
    return sys.platform == "linux" and platform.libc_ver()[0] != "glibc"


def remedy() -> str:
    """Return what a user who asks for Cyclone can do where it is missing."""
    without = "use -m rtps or leave -m out, which needs no library"
    if has_wheel():
        return f"python -m pip install 'cyclonedds~=11.0.1', or {without}"
    version = ".".join(map(str, sys.version_info[:2]))
    machine = platform.machine() + (" without glibc" if is_linux_without_glibc() else "")
    return f"PyPI has no wheel of it for Python {version} on {sys.platform} {machine}: {without}"
