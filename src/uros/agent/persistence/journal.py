"""The state file (``--state``): slots of fixed size, followed by an append-only journal.

::

    0      uros state 1, a line of JSON (boot, clean), its CRC; padded with spaces
    4096   4096 slots of 128 bytes, one a client: the state of its streams
    528384 the journal: records, each with a CRC, its client's serial and a running number

A slot has the number of valid records of its client. Further records, and those of a client
without a slot, were never acknowledged to a client. So one write of 128 bytes, which no SIGKILL
splits, commits what was appended before it.

Everything is written by ``pwrite``, so that truncation by another program is an error to report;
with ``mmap`` it would be a SIGBUS. The slots are allocated beforehand, so a full disk stops the
journal only, and the slots then show that records are missing.

Only :func:`open_journal` raises (:class:`JournalError`); the methods that write return whether they
could.
"""

from __future__ import annotations

import errno
import json
import os
import stat
import struct
import zlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

_MAGIC: Final = b"uros state "
_VERSION: Final = b"1"
_SLOTS_AT: Final = 4096
SLOTS: Final = 4096
SLOT_SIZE: Final = 128
_JOURNAL_AT: Final = _SLOTS_AT + SLOTS * SLOT_SIZE
# The most bytes that are read from a journal, and written to it: a file may have many gigabytes.
MAX_JOURNAL: Final = 64 * 1024 * 1024
# Magic, length, serial, number, CRC of the payload; then the CRC of these fields.
_RECORD: Final = struct.Struct("<4sIIII")
_CRC: Final = struct.Struct("<I")
_RECORD_MAGIC: Final = b"\xf5uR1"
RECORD_SIZE: Final = _RECORD.size + _CRC.size
_BOOT_ID: Final = "/proc/sys/kernel/random/boot_id"
_TRIES: Final = 10


class JournalError(Exception):
    """The file cannot be used as a state file; the text has the reason and the remedy."""


@dataclass
class JournalContent:
    """The content of a state file.

    Attributes:
        trusted: Whether nothing that was acknowledged to boards can be missing; False after a crash
            of the machine.
        slots: The valid slots by index.
        records: ``(serial, number, payload)`` of the valid records, in order.
        damaged: What is damaged, as texts for the log.
    """

    trusted: bool = True
    slots: dict[int, bytes] = field(default_factory=dict)
    records: list[tuple[int, int, bytes]] = field(default_factory=list)
    damaged: list[str] = field(default_factory=list)


def record(serial: int, number: int, payload: bytes) -> bytes:
    """Encode a record of the journal."""
    head = _RECORD.pack(_RECORD_MAGIC, len(payload), serial, number, zlib.crc32(payload))
    return head + _CRC.pack(zlib.crc32(head)) + payload


def seal(slot: bytearray) -> None:
    """Write the CRC into a slot's first four bytes."""
    _CRC.pack_into(slot, 0, zlib.crc32(memoryview(slot)[4:]))


def records_in(data: bytes) -> list[tuple[int, int, bytes]]:
    """Return ``(serial, number, payload)`` of all valid records; bytes between them are skipped."""
    records: list[tuple[int, int, bytes]] = []
    at = 0
    while True:
        at = data.find(_RECORD_MAGIC, at)
        if at < 0 or at + RECORD_SIZE > len(data):
            return records
        _, length, serial, number, crc = _RECORD.unpack_from(data, at)
        start = at + RECORD_SIZE
        if _CRC.unpack_from(data, start - 4)[0] != zlib.crc32(data[at : start - 4]):
            at += 1
            continue
        payload = data[start : start + length]
        if len(payload) < length:
            at += 1  # the record is cut off; others may follow in its place
            continue
        # A valid head has the position of the next record: each payload is read only once.
        if zlib.crc32(payload) == crc:
            records.append((serial, number, payload))
        at = start + length


def _boot_id() -> str:
    """Return the kernel's boot id; "" if there is none."""
    try:
        with open(_BOOT_ID, encoding="ascii") as file:
            return file.read(64).strip()
    except (OSError, ValueError):
        return ""


def _head(clean: bool) -> bytes:
    line = json.dumps({"boot": _boot_id(), "clean": clean}).encode()
    text = _MAGIC + _VERSION + b"\n" + line + b"\n%08x\n" % zlib.crc32(line)
    return text.ljust(_SLOTS_AT - 1) + b"\n"


def _read_head(head: bytes) -> bool | None:
    """Return whether the file can be trusted; None if its head is damaged."""
    lines = head.split(b"\n")
    try:
        if len(lines) < 3 or int(lines[2], 16) != zlib.crc32(lines[1]):
            return None
        header: Any = json.loads(lines[1])
        boot = _boot_id()
        return bool(header["clean"]) or (bool(boot) and header["boot"] == boot)
    except (ValueError, TypeError, KeyError, RecursionError):
        return None


def _refusal(path: str, error: OSError) -> JournalError:
    remedy = {
        errno.EISDIR: "it is a directory: name a file in it",
        errno.ENOENT: "its directory does not exist: create it",
        errno.EACCES: "this user may not write there: choose another path, or change its owner",
        errno.EPERM: "this user may not write there: choose another path, or change its owner",
        errno.EROFS: "the file system is read-only: choose another path",
        errno.ENOSPC: "the disk is full: free some space, or choose another path such as /run",
        errno.EDQUOT: "the quota is exceeded: free some space, or choose another path such as /run",
    }.get(error.errno or 0, error.strerror or str(error))
    return JournalError(f"--state {path}: {remedy}")


def _write_all(fd: int, data: bytes | bytearray, at: int) -> None:
    """Write all bytes or raise OSError."""
    view = memoryview(data)
    while view:
        done = os.pwrite(fd, view, at)
        if done <= 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        view, at = view[done:], at + done


def _read_all(fd: int, size: int, at: int) -> bytes:
    """Read at most ``size`` bytes."""
    parts = []
    while size > 0:
        part = os.pread(fd, min(size, 1 << 20), at)
        if not part:
            break
        parts.append(part)
        size, at = size - len(part), at + len(part)
    return b"".join(parts)


# The first record of a journal, of no client: if it is missing, the file was truncated.
_MARK: Final = record(0, 0, b"")


class Journal:
    """An open and locked state file; made by :func:`open_journal`.

    Attributes:
        path: Its path.
        error: Why the last write failed.
    """

    def __init__(self, path: str, fd: int) -> None:
        self.path = path
        self._fd = fd
        self._end = 0  # where the next record goes; 0: this process has written nothing yet
        self.error = ""  # why the last write failed
        self._cleared = False

    @property
    def journal_size(self) -> int:
        """The bytes of the journal, without the head and the slots of the file."""
        return max(0, self._end - _JOURNAL_AT)

    def read(self) -> JournalContent:
        """Read the file; damage is part of the result, nothing is raised."""
        content = JournalContent()
        try:
            size = os.fstat(self._fd).st_size
            if size == 0:
                return content
            trusted = _read_head(_read_all(self._fd, _SLOTS_AT, 0))
            slots = _read_all(self._fd, SLOTS * SLOT_SIZE, _SLOTS_AT)
            journal = _read_all(self._fd, MAX_JOURNAL, _JOURNAL_AT)
        except OSError as error:
            content.damaged.append(f"it cannot be read: {error.strerror}")
            return content
        if trusted is None:
            content.damaged.append("its head is damaged")
        content.trusted = bool(trusted)
        if len(slots) < SLOTS * SLOT_SIZE:
            content.damaged.append("it is truncated")
        if size > _JOURNAL_AT + MAX_JOURNAL:
            content.damaged.append(f"it has {size} bytes")
        broken = 0
        for index in range(len(slots) // SLOT_SIZE):
            slot = slots[index * SLOT_SIZE : (index + 1) * SLOT_SIZE]
            if not slot.strip(b"\0"):
                continue
            if _CRC.unpack_from(slot)[0] == zlib.crc32(slot[4:]):
                content.slots[index] = slot
            else:
                broken += 1
        if broken:
            content.damaged.append(f"{broken} slots are damaged")
        content.records = [entry for entry in records_in(journal) if entry[0]]
        return content

    def keep_aside(self) -> str | None:
        """Rename a damaged file, for a person to examine; return the new name, None on failure.

        The next :meth:`rewrite` makes a new file.
        """
        aside = self.path + ".damaged"
        try:
            os.replace(self.path, aside)
        except OSError:
            return None
        return aside

    def rewrite(
        self, slots: Mapping[int, bytes | bytearray], journal: Iterable[bytes], sync: bool = False
    ) -> bool:
        """Replace the file atomically; False: it stays as it is, see ``error``."""
        beside = self.path + ".new"
        fd = -1
        try:
            try:
                os.unlink(beside)  # left by an agent that was killed: we hold the lock
            except FileNotFoundError:
                pass
            fd = os.open(beside, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600)
            fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if hasattr(os, "posix_fallocate"):
                os.posix_fallocate(fd, 0, _JOURNAL_AT)
            else:  # macOS
                _write_all(fd, bytes(_JOURNAL_AT), 0)
            _write_all(fd, _head(False), 0)
            for index, slot in slots.items():
                _write_all(fd, slot, _SLOTS_AT + index * SLOT_SIZE)
            end, waiting = _JOURNAL_AT, bytearray(_MARK)
            for encoded in journal:
                waiting += encoded
                if len(waiting) > 1 << 20:
                    _write_all(fd, waiting, end)
                    end, waiting = end + len(waiting), bytearray()
                if end + len(waiting) - _JOURNAL_AT > MAX_JOURNAL:
                    raise OSError(errno.EFBIG, f"over {MAX_JOURNAL >> 20} MB of state")
            _write_all(fd, waiting, end)
            end += len(waiting)
            if sync:
                os.fsync(fd)
            self._check_owner()
            os.replace(beside, self.path)
            if sync:
                self._sync_directory()
        except OSError as error:
            self.error = error.strerror or str(error)
            if fd >= 0:
                os.close(fd)
                try:
                    os.unlink(beside)
                except OSError:
                    pass
            return False
        os.close(self._fd)
        self._fd, self._end, self._cleared = fd, end, False
        return True

    def _check_owner(self) -> None:
        """Raise OSError if the path is another agent's file by now."""
        try:
            fd = os.open(self.path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
        except FileNotFoundError:
            return
        try:
            own_status, named_status = os.fstat(self._fd), os.fstat(fd)
            if (own_status.st_dev, own_status.st_ino) != (named_status.st_dev, named_status.st_ino):
                fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise OSError(errno.EBUSY, "another agent uses it now") from None
        finally:
            os.close(fd)

    def clear(self) -> None:
        """Remove outdated content, so that no later agent restores it; until :meth:`rewrite`."""
        self._cleared = True
        try:
            os.ftruncate(self._fd, 0)
        except OSError:
            try:
                os.unlink(self.path)
            except OSError:
                pass

    def _sync_directory(self) -> None:
        directory = os.open(os.path.dirname(self.path) or ".", os.O_RDONLY | os.O_CLOEXEC)
        try:
            os.fsync(directory)
        finally:
            os.close(directory)

    def append(self, records: bytes | bytearray) -> bool:
        """Append whole records; False: none of them was written, see ``error``."""
        try:
            if self.journal_size + len(records) > MAX_JOURNAL:
                raise OSError(errno.EFBIG, f"over {MAX_JOURNAL >> 20} MB of state")
            _write_all(self._fd, records, self._end)
        except OSError as error:
            self.error = error.strerror or str(error)
            try:
                os.ftruncate(self._fd, self._end)  # no incomplete record
            except OSError:
                pass
            return False
        self._end += len(records)
        return True

    def write_slot(self, index: int, slot: bytes | bytearray) -> bool:
        """Write one slot; False: see ``error``."""
        if self._cleared:
            return True  # a file with one slot only would be refused by the next agent
        try:
            return os.pwrite(self._fd, slot, _SLOTS_AT + index * SLOT_SIZE) == SLOT_SIZE
        except OSError as error:
            self.error = error.strerror or str(error)
            return False

    def missing(self) -> str | None:
        """Return how another program has changed the file; None if none has."""
        try:
            own_status = os.fstat(self._fd)
            named_status = os.stat(self.path)
        except FileNotFoundError:
            return "the file was deleted"
        except OSError as error:
            return error.strerror or str(error)
        if (own_status.st_dev, own_status.st_ino) != (named_status.st_dev, named_status.st_ino):
            return "another file has its name"
        try:
            mark = os.pread(self._fd, len(_MARK), _JOURNAL_AT)
        except OSError as error:
            return error.strerror or str(error)
        # After a truncation, records appended since may have made it long again.
        if own_status.st_size < self._end or mark != _MARK:
            return "the file was truncated"
        return None

    def close(self, clean: bool) -> None:
        """Close the file; ``clean``: it is complete, and marked valid after a power cycle too."""
        if self._fd < 0:
            return
        try:
            if clean and self._end:
                os.fsync(self._fd)
                _write_all(self._fd, _head(True), 0)
                os.fsync(self._fd)
        except OSError:
            pass  # it remains valid until the machine restarts
        os.close(self._fd)
        self._fd = -1


def open_journal(path: str) -> Journal:
    """Open and lock a state file; create an empty one if there is none.

    Raises:
        JournalError: The file is no state file, of another version, in use, or no regular file.
            It is not changed then.
    """
    _check_system()
    try:
        path = os.path.realpath(path)
        for _ in range(_TRIES):
            fd = _open_and_lock(path)
            try:
                named_status = os.stat(path)
                own_status = os.fstat(fd)
                if (own_status.st_dev, own_status.st_ino) == (
                    named_status.st_dev,
                    named_status.st_ino,
                ):
                    return _checked(path, fd)
            except FileNotFoundError:
                pass
            except BaseException:
                os.close(fd)
                raise
            os.close(fd)  # its owner has replaced it meanwhile
    except OSError as error:
        raise _refusal(path, error) from error
    except ValueError as error:  # a NUL in the name
        raise JournalError(f"--state {path!r}: {error}") from error
    raise _in_use(path)


def check_state_file(path: str) -> None:
    """Check what a state file has now; nothing is created, changed or locked.

    Raises:
        JournalError: An agent would refuse the file for its kind or its content.
    """
    _check_system()
    try:
        path = os.path.realpath(path)
        if not stat.S_ISREG(os.stat(path).st_mode):
            raise _not_regular(path)
        fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    except FileNotFoundError:
        return
    except OSError as error:
        raise _refusal(path, error) from error
    try:
        _check_content(path, fd)
    finally:
        os.close(fd)


def _check_system() -> None:
    if fcntl is None:
        raise JournalError("--state is for systems with file locks, such as Linux and macOS")


def _in_use(path: str) -> JournalError:
    return JournalError(
        f"--state {path}: another agent uses it: stop that agent, or give each agent its own file"
    )


def _open_and_lock(path: str) -> int:
    try:
        if not stat.S_ISREG(os.stat(path).st_mode):
            raise _not_regular(path)
    except FileNotFoundError:
        pass
    flags = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NONBLOCK
    fd = os.open(path, flags, 0o600)
    try:
        if not stat.S_ISREG(os.fstat(fd).st_mode):
            raise _not_regular(path)
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(fd)
        raise _in_use(path) from None
    except BaseException:
        os.close(fd)
        raise
    return fd


def _not_regular(path: str) -> JournalError:
    reason = "a directory: name a file in it" if os.path.isdir(path) else "no regular file"
    return JournalError(f"--state {path}: it is {reason}")


def _has_slots(fd: int) -> bool:
    """Return whether a file without a head has slots: it was truncated while an agent wrote."""
    slots = _read_all(fd, SLOTS * SLOT_SIZE, _SLOTS_AT)
    whole = range(0, len(slots) - SLOT_SIZE + 1, SLOT_SIZE)
    each = (slots[at : at + SLOT_SIZE] for at in whole)
    return any(
        slot.strip(b"\0") and _CRC.unpack_from(slot)[0] == zlib.crc32(slot[4:]) for slot in each
    )


def _checked(path: str, fd: int) -> Journal:
    if _check_content(path, fd):
        os.fchmod(fd, 0o600)
    return Journal(path, fd)


def _check_content(path: str, fd: int) -> bool:
    """Raise JournalError for another file than a state file; return whether it has a head."""
    first = os.pread(fd, len(_MAGIC) + 8, 0)
    if not first or (not first.strip(b"\0") and _has_slots(fd)):
        return False  # empty, or treated as damaged, as its head is missing
    if not first.startswith(_MAGIC):
        raise JournalError(
            f"--state {path}: it is no state file of uros and is not changed: give another path"
        )
    version = first[len(_MAGIC) :].split(b"\n")[0]
    if version != _VERSION:
        text = version.decode("ascii", "replace")
        if text.isdecimal() and int(text) > int(_VERSION):
            raise JournalError(
                f"--state {path}: a newer uros wrote it (format {text}, this one has"
                f" {_VERSION.decode()}) and it is not changed: start that version again, or"
                " name another file (boards then start anew)"
            )
        raise JournalError(
            f"--state {path}: it is of another version of uros ({text!r}) and is not"
            " changed: use that version, or remove the file (boards then start anew)"
        )
    return True
