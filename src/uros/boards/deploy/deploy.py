"""Copies a built file system to a board by the raw REPL of its console.

::

    device = look(repl)
    plan = make_plan(repl, device, files)
    carry_out(repl, device, plan, files)

Only files that differ are sent. They are written to the staging folder `STAGE` and verified there
by their SHA-256, computed on the board, before any file in use changes. Then one piece of code on
the board moves all files into place; it reads no input. So if the line breaks, the old files are
intact. While that code runs, for milliseconds, the board has no main.py: a board that loses power
then starts no program, rather than a mixture of old and new files.

The file `NOTE` on the board lists the deployed files. The next deployment removes listed files that
are no longer needed, and leaves all other files alone. The file of secrets is not listed, so it
stays until another one replaces it, and no error quotes it.
"""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Final

from ..builder.secrets_file import FILE as SECRETS
from . import literal, mpy_abi
from .raw_repl import LineLost, Raised, RawRepl, WrongAnswer

NOTE: Final = ".uros-files"
STAGE: Final = ".uros-new"
MAIN: Final = "main.py"
# Octets of a file per command. A chunk takes four times its size of the board's memory: its text
# twice, and its content.
_CHUNK: Final = 768
# littlefs uses two blocks for each folder; a copy-on-write file system needs some spare blocks.
_FOLDER_BLOCKS: Final = 2
_SPARE_BLOCKS: Final = 4
# Attack: a name of 8 MB.
_LONGEST_WORD: Final = 100

Progress = Callable[[str, int, int], object]
"""Called with a path, the octets of all files sent so far, and the octets to send in total."""

_HELPERS: Final = """\
import os, sys
from binascii import a2b_base64 as _b, hexlify as _x
try:
 from hashlib import sha256 as _s
except ImportError:
 _s = None
def _kind(p):
 try:
  return os.stat(p)[0] & 0x4000
 except OSError:
  return None
def _hash(p):
 if _kind(p) != 0:
  return ''
 f = open(p, 'rb')
 h = _s() if _s else None
 a = bytearray(256)
 m = memoryview(a)
 o = []
 while 1:
  n = f.readinto(a)
  if not n:
   break
  if h:
   h.update(m[:n])
  else:
   o.append(_x(m[:n]).decode())
 f.close()
 return _x(h.digest()).decode() if h else ''.join(o)
def _tree(p, d=''):
 for e in os.ilistdir(p):
  if e[1] & 0x4000:
   for q in _tree(p + '/' + e[0], d + e[0] + '/'):
    yield q
   yield d + e[0] + '/'
  else:
   yield d + e[0]
def _rm(p):
 try:
  os.remove(p)
 except OSError:
  pass
def _rmdir(p):
 try:
  os.rmdir(p)
 except OSError:
  pass
def _mk(p):
 i = p.find('/', len(_r))
 while i > 0:
  if _kind(p[:i]) is None:
   os.mkdir(p[:i])
  i = p.find('/', i + 1)
_r = os.getcwd().rstrip('/') + '/'
"""

_PUT: Final = """\
def _put(new, old, folders, hold, note):
 s = _r + STAGE + '/'
 m = _r + 'main.py'
 if hold and _kind(m) == 0:
  os.rename(m, s + 'main')
 for p in old:
  _rm(_r + p)
 for n, p in new:
  _mk(_r + p)
  os.rename(s + str(n), _r + p)
 for p in folders:
  _rmdir(_r + p)
 f = open(_r + NOTE, 'w')
 f.write(note)
 f.close()
 if _kind(m) is None and _kind(s + 'main') == 0:
  os.rename(s + 'main', m)
 _rm(s + 'main')
 _rmdir(_r + STAGE)
"""


class DeployError(RuntimeError):
    """The files cannot be deployed to this board; the text names the reason and the remedy."""


@dataclass(frozen=True)
class Device:
    """The board at the other end of the line.

    Args:
        name: ``sys.implementation.name``.
        version: Version of the firmware.
        platform: ``sys.platform``.
        machine: Board and microcontroller; empty if the firmware does not tell.
        mpy: ``sys.implementation._mpy``: which bytecode the firmware runs; None if it runs none.
        root: Folder that the files go to, with a slash at its end.
        block: Block size of the file system, in bytes.
        free: Free space of the file system, in bytes; None if unknown.
        hashes: Whether the firmware has SHA-256.
    """

    name: str
    version: str
    platform: str
    machine: str
    mpy: int | None
    root: str
    block: int
    free: int | None
    hashes: bool

    def digest(self, data: bytes) -> str:
        """Return the board's digest of this content: SHA-256, or the content in hex."""
        return hashlib.sha256(data).hexdigest() if self.hashes else data.hex()


@dataclass
class Plan:
    """What a deployment changes; all paths are relative to the board's root.

    Args:
        write: Files to send.
        keep: Files that are on the board already.
        remove: Files to remove.
        folders: Folders to remove if they are empty, innermost first.
        noted: Whether the board's `NOTE` is up to date.
    """

    write: list[str] = field(default_factory=list)
    keep: list[str] = field(default_factory=list)
    remove: list[str] = field(default_factory=list)
    folders: list[str] = field(default_factory=list)
    noted: bool = False

    @property
    def changes(self) -> bool:
        """Whether the deployment changes anything on the board."""
        return bool(self.write or self.remove or not self.noted)


def look(repl: RawRepl) -> Device:
    """Identify the board; raise DeployError if its firmware lacks what copying needs."""
    try:
        repl.run(_HELPERS)
    except Raised as error:
        raise DeployError(f"the firmware lacks what copying needs: {error.last}") from error
    answer = _ask(
        repl,
        "_i = sys.implementation\n"
        "try:\n _v = os.statvfs(_r)\nexcept OSError:\n _v = None\n"
        "print(repr((_i.name, '.'.join(str(n) for n in _i.version[:3]), sys.platform,"
        " getattr(_i, '_machine', ''), getattr(_i, '_mpy', None), _r,"
        " _v and (_v[0], _v[3]), _s is not None)))",
    )
    match answer:
        case (
            str(name),
            str(version),
            str(platform),
            str(machine),
            mpy,
            str(root),
            space,
            bool(hashes),
        ) if all(len(word) <= _LONGEST_WORD for word in (name, version, platform, machine, root)):
            pass
        case _:
            raise _unexpected_answer(answer)
    block, free = 4096, None
    match space:
        case (int(block), int(blocks)) if block > 0 and blocks >= 0:
            free = block * blocks
        case (0, 0):
            raise DeployError(
                f"the board has no file system at {root}: MicroPython could not make or mount one"
                " in its flash; erase the flash, and copy MicroPython's image to it again"
            )
        case None:
            pass
        case _:
            raise _unexpected_answer(answer)
    if not isinstance(mpy, int | None):
        raise _unexpected_answer(answer)
    return Device(
        name, version, platform, machine, mpy, root, block, free, hashes,
    )  # fmt: skip


def check(device: Device, files: Mapping[str, bytes]) -> None:
    """Raise DeployError if the board's firmware cannot run the files."""
    if device.name != "micropython":
        raise DeployError(
            f"the board runs {device.name} {device.version}, and uros needs MicroPython: flash that"
        )
    if fault := mpy_abi.misfit(device.mpy, device.version, files):
        raise DeployError(fault)


def make_plan(
    repl: RawRepl, device: Device, files: Mapping[str, bytes], clean: bool = False
) -> Plan:
    """Compare the board with ``files`` and plan the changes.

    Args:
        repl: Raw REPL on which `look` ran.
        device: The result of `look`.
        files: Content of each file, by path.
        clean: Whether to remove all files of the board that are not in ``files``.

    Raises:
        DeployError: A file on the board that uros did not deploy would be imported in place of
            one of ``files``.
    """
    plan = Plan()
    for path, digest in _digests(repl, files).items():
        same = digest == device.digest(files[path])
        (plan.keep if same else plan.write).append(path)
    note = _text(repl, NOTE)
    old = [path for path in note.split("\n") if path and path not in files]
    present = _tree(repl)
    own = {NOTE, STAGE + "/", *files}
    own.update(path for path in present if path.startswith(STAGE + "/"))
    plan.remove = sorted(
        path for path in present - own if not path.endswith("/") and (clean or path in old)
    )
    folders = {path for path in present - own if path.endswith("/")}
    used_folders = {path.rpartition("/")[0] + "/" for path in files if "/" in path}
    plan.folders = sorted(
        (
            path[:-1]
            for path in folders
            if not any(folder.startswith(path) for folder in used_folders)
            and (clean or any(folder.startswith(path) for folder in old))
        ),
        reverse=True,
    )
    remaining = present - own - set(plan.remove) - {path + "/" for path in plan.folders}
    _check_shadows(files, remaining)
    plan.noted = note == _note(files)
    return plan


def _check_shadows(files: Mapping[str, bytes], remaining: set[str]) -> None:
    """Check import precedence: MicroPython prefers folders to files, and text to bytecode."""
    packages = {path.split("/")[0] for path in files if "/" in path}
    for path in files:
        stem, _, form = path.rpartition(".")
        if form not in ("py", "mpy") or not stem or stem in packages:
            continue
        shadows = [stem + "/"] + ([stem + ".py"] if form == "mpy" else [])
        for shadow in shadows:
            if shadow in remaining:
                raise DeployError(
                    f"{shadow} is on the board, nobody knows whose, and would be loaded instead of"
                    f" {path}: remove it (mpremote connect PORT rm -r :{shadow.rstrip('/')}), or"
                    " give --clean, which removes all that is not of this program"
                )


def needed(device: Device, plan: Plan, files: Mapping[str, bytes]) -> int:
    """Return an upper limit of the space, in bytes, that the new files need beside the old."""
    blocks = sum(-(-len(files[path]) // device.block) for path in plan.write)
    folders = {path.rpartition("/")[0] for path in plan.write} | {STAGE}
    return (blocks + _FOLDER_BLOCKS * len(folders) + _SPARE_BLOCKS) * device.block


def has_secrets(repl: RawRepl) -> bool:
    """Return whether the board has a file of secrets; `look` ran on ``repl``."""
    return _ask(repl, f"print(_kind(_r + {SECRETS!r}) == 0)") is True


def check_room(device: Device, plan: Plan, files: Mapping[str, bytes]) -> None:
    """Raise DeployError if the new files do not fit beside the old ones."""
    wanted = needed(device, plan, files)
    if plan.write and device.free is not None and wanted > device.free:
        raise DeployError(
            f"the board has {device.free} bytes free, and the new files need about {wanted} beside"
            " the old ones: give --mpy, which makes them smaller, or --in-place, which removes the"
            " old ones first, or free some: mpremote connect PORT fs ls -r"
        )


def carry_out(
    repl: RawRepl,
    device: Device,
    plan: Plan,
    files: Mapping[str, bytes],
    progress: Progress = lambda path, done, size: None,
    in_place: bool = False,
) -> None:
    """Carry out a plan, then verify all files.

    Args:
        repl: Raw REPL on which `look` ran.
        device: The result of `look`.
        plan: The result of `make_plan`.
        files: Content of each file, by path.
        progress: Called after each chunk.
        in_place: Whether to remove old files first, for boards without space for both.

    Raises:
        DeployError: The board cannot store the files, or one is damaged.
        ReplError: The line failed.
    """
    size = sum(len(files[path]) for path in plan.write)
    repl.run(f"STAGE = {STAGE!r}\nNOTE = {NOTE!r}\n" + _PUT)
    stage = STAGE + "/"
    try:
        repl.run(
            "if _kind(_r + STAGE) is None:\n os.mkdir(_r + STAGE)\n"
            "for p in list(_tree(_r + STAGE)):\n _rm(_r + STAGE + '/' + p)"
        )
        if in_place:
            obsolete = [MAIN, *plan.write, *plan.remove]
            repl.run(f"for p in {obsolete!r}:\n _rm(_r + p)", repl.seconds.long)
            if MAIN in plan.keep:
                plan.keep.remove(MAIN)
                plan.write.append(MAIN)
                size += len(files[MAIN])
        order = sorted(plan.write, key=lambda path: (path == MAIN, path))
        done = 0
        for number, path in enumerate(order):

            def report(written: int, path: str = path, done: int = done) -> None:
                progress(path, done + written, size)

            try:
                _write(repl, f"{stage}{number}", files[path], report)
            except (LineLost, WrongAnswer) as error:
                if path != SECRETS:
                    raise
                # An echo of the line would quote what was sent.
                raise type(error)(f"the line failed while it took {path}") from None
            _compare(repl, device, f"{stage}{number}", path, files[path])
            done += len(files[path])
        new = list(enumerate(order))
        hold = bool(order or plan.remove) and MAIN not in plan.remove
        repl.run(
            f"_put({new!r}, {plan.remove!r}, {plan.folders!r}, {hold!r}, {_note(files)!r})",
            repl.seconds.long,
        )
    except Raised as error:
        raise DeployError(_store_error(error)) from error
    for path, digest in _digests(repl, files).items():
        if digest != device.digest(files[path]):
            raise DeployError(f"{path} on the board is not what was sent: {_WORN_FLASH}")


_WORN_FLASH: Final = "try again; if it stays so, its flash is worn or its file system damaged"


def _write(repl: RawRepl, path: str, data: bytes, done: Callable[[int], object]) -> None:
    repl.run(f"_f = open(_r + {path!r}, 'wb')")
    for at in range(0, len(data), _CHUNK):
        chunk = data[at : at + _CHUNK]
        # Base64 and not repr(), which takes four octets for most octets of bytecode.
        repl.run(f"_f.write(_b({base64.b64encode(chunk)!r}))")
        done(at + len(chunk))
    repl.run("_f.close()")


def _compare(repl: RawRepl, device: Device, path: str, name: str, data: bytes) -> None:
    digest = _ask(repl, f"print(repr(_hash(_r + {path!r})))", repl.seconds.long)
    if digest != device.digest(data):
        raise DeployError(
            f"{name} arrived damaged, and nothing was changed: use a shorter cable or a lower baud"
            " rate, and try again"
        )


def _store_error(error: Raised) -> str:
    last = error.last
    if "MemoryError" in last:
        return "the board has not enough memory to take files: press its reset button, try again"
    if "28" in last or "ENOSPC" in last:
        return (
            "the board's file system is full: give --mpy, which makes files smaller, or --in-place,"
            " or free some: mpremote connect PORT fs ls -r"
        )
    if "30" in last or "EROFS" in last:
        return (
            "the board's file system cannot be written to; where a computer has it as a USB drive,"
            " eject that first"
        )
    return f"the board cannot write its files ({last}): {_WORN_FLASH}"


def _note(files: Mapping[str, bytes]) -> str:
    return "\n".join(sorted(files.keys() - {SECRETS}))


def _digests(repl: RawRepl, files: Mapping[str, bytes]) -> dict[str, str]:
    """Return the board's digest of each file, sorted by path; empty if the file does not exist."""
    paths = sorted(files)
    code = f"print(repr([_hash(_r + p) for p in {paths!r}]))"
    answer = _texts(_ask(repl, code, repl.seconds.long))
    if len(answer) != len(paths):
        raise _unexpected_answer(answer)
    return dict(zip(paths, answer, strict=True))


def _tree(repl: RawRepl) -> set[str]:
    """Return all paths below the board's root; paths of folders end with a slash."""
    code = "print(repr([p for p in _tree(_r[:-1] or '/')]))"
    return set(_texts(_ask(repl, code, repl.seconds.long)))


def _text(repl: RawRepl, path: str) -> str:
    answer = _ask(
        repl,
        f"if _kind(_r + {path!r}) == 0:\n _f = open(_r + {path!r})\n print(repr(_f.read()))\n"
        " _f.close()\nelse:\n print(\"''\")",
    )
    if isinstance(answer, str):
        return answer
    raise _unexpected_answer(answer)


def _texts(answer: object) -> list[str]:
    """Return the answer as a list of texts; raise DeployError if it is anything else."""
    if isinstance(answer, list):
        texts = [item for item in answer if isinstance(item, str)]
        if len(texts) == len(answer):
            return texts
    raise _unexpected_answer(answer)


def _ask(repl: RawRepl, code: str, seconds: float | None = None) -> literal.Literal:
    """Run code that prints the repr of one value; return that value, of any type."""
    output = repl.run(code, seconds).strip()
    # A timer or interrupt of boot.py may print before; the repr is the last line.
    last = output[output.rfind("\n") + 1 :]
    try:
        return literal.parse(last)
    except ValueError:
        raise _unexpected_answer(last, False) from None


def _unexpected_answer(answer: object, quote: bool = True) -> DeployError:
    quoted = repr(answer) if quote else str(answer)
    return DeployError(
        f"the board said {quoted[-80:]!r} where it was to answer: press its reset button, and try"
        " again; if it stays so, it runs no MicroPython: docs/ports.md"
    )
