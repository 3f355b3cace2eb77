"""Compression: zstd by Python or the package zstandard, lz4 by the package lz4."""

from __future__ import annotations

import importlib
import io
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from typing import Any, Final

from .errors import BagError

NAMES: Final = ("zstd", "lz4")
_STEP: Final = 1 << 20
# Attack: data that unpack to 32,000 times their size. Of so many octets, 128 MiB may come at once.
_SLICE: Final = 4096
# Where each is, by the names of modules; Python has zstd of its own from 3.14 on.
_MODULES: Final = {"zstd": ("compression.zstd", "zstandard"), "lz4": ("lz4.frame",)}
_PACKAGES: Final = {"zstd": "zstandard", "lz4": "lz4"}


class Broken(Exception):
    """Data that no compressor has made, or that are cut off."""


def why_missing(name: str) -> str:
    """Return why a compression cannot be used here; empty if it can."""
    if name not in NAMES:
        return f"there is no compression {name!r:.20}; uros has {' and '.join(NAMES)}"
    if _module(name) is None:
        package = _PACKAGES[name]
        return (
            f"{name} needs the package {package}: pip install 'uros[compression]', or pip install"
            f" {package} where this has no {package} for the platform"
        )
    return ""


def compressor(name: str | None) -> Callable[[bytes], bytes]:
    """Return what compresses a chunk; None stands for no compression.

    Raises:
        BagError: The compression is unknown, or its package is missing.
    """
    if name is None:
        return bytes
    if why := why_missing(name):
        raise BagError(why)
    compress: Callable[[bytes], bytes] = _module(name).compress
    return compress


def decompressed(name: str, data: bytes, most: int) -> Iterator[bytes]:
    """Yield what was compressed in parts, at most ``most`` bytes.

    Raises:
        BagError: The compression is unknown, or its package is missing.
        Broken: The data are damaged or cut off; what was yielded before is good.
    """
    if why := why_missing(name):
        raise BagError(why)
    module = _module(name)
    stream: Any
    try:
        if name == "lz4":
            stream = module.LZ4FrameFile(io.BytesIO(data))
        elif hasattr(module, "ZstdDecompressor") and hasattr(module, "ZstdFile"):
            stream = module.ZstdFile(io.BytesIO(data))
        else:
            stream = module.ZstdDecompressor().stream_reader(data)
        with stream:
            while most and (part := stream.read(min(most, _STEP))):
                yield part
                most -= len(part)
    except BagError:
        raise
    # Each package has errors of its own, some without a common class.
    except (Exception, MemoryError) as error:
        raise Broken(str(error)) from error


def unpacker() -> Callable[[Iterable[bytes]], Iterator[bytes]]:
    """Return what yields the content of a frame of zstd in parts.

    It takes the frame in parts of any size, and raises Broken if they are damaged or cut off; what
    was yielded before is good.

    Raises:
        BagError: The package of zstd is missing.
    """
    if why := why_missing("zstd"):
        raise BagError(why)
    make = _module("zstd").ZstdDecompressor
    of_package = getattr(make(), "decompressobj", None)
    return partial(_frame, of_package or make)


def _frame(make: Callable[[], Any], data: Iterable[bytes]) -> Iterator[bytes]:
    decompressor = make()
    for part in data:
        for at in range(0, len(part), _SLICE):
            try:
                unpacked = decompressor.decompress(part[at : at + _SLICE])
            except Exception as error:  # each package has one of its own
                raise Broken(str(error)) from error
            if unpacked:
                yield unpacked
            if decompressor.eof:
                return
    raise Broken("it is cut off")


def _module(name: str) -> Any:
    for module in _MODULES[name]:
        try:
            return importlib.import_module(module)
        except (ImportError, OSError):
            continue
    return None
