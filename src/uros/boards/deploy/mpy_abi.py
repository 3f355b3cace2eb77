"""Which bytecode a board's firmware loads: the header of .mpy files, and ``_mpy`` of the firmware.

A file begins with ``M``, the version of the bytecode, an octet with the architecture of its machine
code (none in most files) and the sub-version of that, and the width of small integers. A firmware's
``sys.implementation._mpy`` has the version in its lowest octet and the other two above it. See "MPY
files" in MicroPython's documentation.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

_ARCHITECTURES: Final = (
    "none", "x86", "x64", "armv6", "armv6m", "armv7m", "armv7em", "armv7emsp", "armv7emdp",
    "xtensa", "xtensawin", "rv32imc", "rv64imc",
)  # fmt: skip
# Thumb code of one of these runs on those behind it.
_THUMB: Final = range(4, 9)
_HEADER: Final = 4
# MicroPython's releases that read version 6 are 1.19 and later; uros is tested with this one.
_TESTED: Final = "1.27"


def _name(architecture: int) -> str:
    if architecture < len(_ARCHITECTURES):
        return _ARCHITECTURES[architecture]
    return f"architecture {architecture}"


def misfit(mpy: int | None, firmware: str, files: Mapping[str, bytes]) -> str:
    """Return why a firmware cannot load one of the files, with the remedy; "" if it loads all.

    Args:
        mpy: Its ``sys.implementation._mpy``; None if it has none.
        firmware: Its version.
        files: Content of the files for the board, by path.
    """
    for path in sorted(files):
        if path.endswith(".mpy"):
            fault = _misfit(mpy, firmware, path, files[path][:_HEADER])
            if fault:
                return fault
    return ""


def _misfit(mpy: int | None, firmware: str, path: str, header: bytes) -> str:
    if len(header) < _HEADER or header[0] != ord("M"):
        return f"{path} is no bytecode of MicroPython: remove it from the program, or build it anew"
    version, sub_version, architecture = header[1], header[2] & 3, header[2] >> 2 & 15
    board = f"MicroPython {firmware} on the board"
    if mpy is None or mpy & 0xFF != version:
        reads = "none" if mpy is None else f"version {mpy & 0xFF}"
        return (
            f"{path} is bytecode of version {version}, and {board} reads {reads}: flash MicroPython"
            f" {_TESTED}, or leave --mpy out"
        )
    if not architecture:
        return ""
    own, own_sub_version = mpy >> 10 & 15, mpy >> 8 & 3
    is_thumb = architecture in _THUMB and own in _THUMB
    if architecture != own and not (is_thumb and architecture < own):
        remedy = "take the module as text"
        if own:
            remedy = f"build it for {_name(own)}, or {remedy}"
        return (
            f"{path} has machine code for {_name(architecture)}, and {board} loads that for"
            f" {_name(own)}: {remedy}"
        )
    if sub_version != own_sub_version:
        return (
            f"{path} has machine code of version {version}.{sub_version}, and {board} loads"
            f" {version}.{own_sub_version}: build it with the sources of that MicroPython"
        )
    return ""
