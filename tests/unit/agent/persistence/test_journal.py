"""The state file: arbitrary content, and failing disks."""

import errno
import os
import resource
import shutil
import signal
import subprocess
import sys
from functools import lru_cache

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from support.examples import examples

from uros.agent.persistence import journal as state
from uros.agent.persistence.journal import (
    JournalContent,
    JournalError,
    open_journal,
    record,
    records_in,
)
from uros.agent.persistence.records import (
    ClientInfo,
    ClientRecords,
    DamagedRecords,
    Incoming,
    Outgoing,
)

JUNK = b"\x00\xff junk"


def client(key):
    """Return the records of a client with something of every kind."""
    return ClientRecords(
        info=ClientInfo(key, 0x81, 512, "UDPv4Agent port 8888", ("127.0.0.1", key), [("a", "b")]),
        objects={0x11: (3, b"\0\1binary", 1, 0, True), 0x12: (2, "<dds/>", 2, 0x11, False)},
        reads={0x16: (40, 0x80, (0xFFFF, 0, 0, 0)), 0x26: (41, 1, None)},
        matched={0x15: 3},
        latched={0x15: b"\0\1\0\0last"},
        best_effort={1: 1024},
        outgoing={0x80: Outgoing(0xFFFE, 1, 2, {n: b"m%d" % n for n in (0xFFFE, 0xFFFF, 0, 1)})},
        incoming={0x80: Incoming(700, bytearray(b"half of a message"), False)},
    )


def fill(path, *keys):
    """Write a state file with these clients, closed as by an orderly shutdown."""
    file = open_journal(str(path))
    slots, journal = {}, []
    for index, key in enumerate(keys):
        slot, records, _ = client(key).encode(index + 1)
        slots[index * 7] = slot
        journal.append(bytes(records))
    assert file.rewrite(slots, journal)
    file.close(clean=True)
    return path.read_bytes()


@lru_cache
def filled(folder):
    whole = fill(folder / "f", 1, 2, 3)
    (folder / "f").unlink()
    return whole


@lru_cache
def places_in_use(whole):
    return [at for at, byte in enumerate(whole) if byte]


def load(path):
    """Return (clients by key, content) of a file."""
    file = open_journal(str(path))
    try:
        content = file.read()
    finally:
        file.close(False)
    return sound(content), content


def sound(content):
    by_serial = {}
    for serial, number, payload in content.records:
        by_serial.setdefault(serial, {})[number] = payload
    clients_by_key = {}
    for slot in content.slots.values():
        serial = state.struct.unpack_from("<I", slot, 4)[0]
        try:
            records = ClientRecords.parse(slot, by_serial.get(serial, {}))
        except DamagedRecords:
            continue
        clients_by_key[records.info.key] = records
    return clients_by_key


def same(records, key):
    expected = client(key)
    for name, value in vars(expected).items():
        if not name.startswith("_"):
            assert getattr(records, name) == value, name


def test_written_records_are_read_back(tmp_path):
    fill(tmp_path / "f", 1, 2, 3)
    clients, content = load(tmp_path / "f")
    assert sorted(clients) == [1, 2, 3] and content.trusted and not content.damaged
    for key in clients:
        same(clients[key], key)
    assert os.stat(tmp_path / "f").st_mode & 0o777 == 0o600


def test_records_behind_the_count_of_the_slot_are_ignored(tmp_path):
    file = open_journal(str(tmp_path / "f"))
    slot, records, count = client(1).encode(1)
    assert file.rewrite({0: slot}, [bytes(records)])
    assert file.append(record(1, count + 1, b"D\x11\x00") + record(9, 1, b"C{}"))
    file.close(False)
    clients, _ = load(tmp_path / "f")
    same(clients[1], 1)


@settings(max_examples=examples(150), suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_any_damage(tmp_path, data):
    """Only JournalError is raised, restored clients are unchanged, one damage loses one client."""
    path = tmp_path / "f"
    if path.exists():
        path.unlink()
    whole = bytearray(filled(path.parent))
    how = data.draw(st.sampled_from(["flip", "cut", "junk", "several"]))
    # Anywhere in the file, but mostly where data is.
    full = places_in_use(bytes(whole))
    places = st.one_of(st.sampled_from(full), st.integers(0, len(whole) - 1))
    if how == "cut":
        del whole[data.draw(places) :]
    elif how == "junk":
        at = data.draw(places)
        whole[at:at] = data.draw(st.binary(min_size=1, max_size=300))
    else:
        for _ in range(1 if how == "flip" else data.draw(st.integers(2, 40))):
            at = data.draw(places)
            whole[at] ^= data.draw(st.integers(1, 255))
    path.write_bytes(bytes(whole))
    try:
        clients, content = load(path)
    except JournalError:
        return
    for key, records in clients.items():
        same(records, key)
    if how == "flip" and content.trusted:
        assert len(clients) >= 2


@settings(max_examples=examples(200))
@given(st.lists(st.one_of(st.binary(max_size=80), st.tuples(
    st.integers(0, 9), st.integers(0, 9), st.binary(max_size=60))), max_size=30))  # fmt: skip
def test_records_are_found_among_arbitrary_bytes(parts):
    stream, expected = b"", []
    for part in parts:
        if isinstance(part, tuple):
            stream += record(*part)
            expected.append(part)
        else:
            stream += part.replace(b"\xf5", b"")
    assert records_in(stream) == expected


@settings(max_examples=examples(200))
@given(
    st.lists(st.one_of(st.binary(max_size=40), st.sampled_from(
        [b"C{}", b"C[]", b"Cnull", b"O[1]\n", b"O[[],1,1,1,1,1]\nx", b"R[1,2,3,[1]]", b"R{}",
         b"T\x80\0\0x", b"F\x80\0\0\0\0part", b"F\x80\xff\xff\xff\xffpart", b"Z", b"N\x80\1\0",
         b"M", b"L", b"C" + b"[" * 9999]
    )), min_size=1, max_size=6),
    st.binary(min_size=112, max_size=112),
)  # fmt: skip
def test_records_with_invalid_content_are_refused(payloads, streams):
    """Records with a valid checksum and any content are parsed or raise DamagedRecords."""
    slot = state.struct.pack("<IIII", 0, 1, len(payloads), 1) + streams
    try:
        ClientRecords.parse(slot, dict(enumerate(payloads, 1)))
    except DamagedRecords:
        pass


def test_a_file_that_is_no_state_file_is_not_changed(tmp_path):
    path = tmp_path / "f"
    for text in (b"#!/bin/sh\n", b"\0" * 100, JUNK):
        path.write_bytes(text)
        with pytest.raises(JournalError, match="no state file of uros and is not changed"):
            open_journal(str(path))
        assert path.read_bytes() == text


def test_a_file_that_was_truncated_after_a_kill_is_a_damaged_state_file(tmp_path):
    path = tmp_path / "f"
    fill(path, 1)
    file = open_journal(str(path))
    content = file.read()
    assert file.rewrite(content.slots, [])
    os.truncate(path, 0)
    index, slot = next(iter(content.slots.items()))
    assert file.write_slot(index, slot)
    os.close(file._fd)  # as SIGKILL leaves it
    again = open_journal(str(path))
    assert "its head is damaged" in again.read().damaged and not again.read().trusted
    assert again.keep_aside() == f"{path}.damaged"
    assert again.rewrite({}, [])
    again.close(True)


def test_a_file_of_a_newer_version_is_not_changed(tmp_path):
    path = tmp_path / "f"
    whole = fill(path, 1).replace(b"uros state 1\n", b"uros state 2\n")
    path.write_bytes(whole)
    with pytest.raises(JournalError, match="a newer uros wrote it .format 2, this one has 1."):
        open_journal(str(path))
    assert path.read_bytes() == whole


def test_a_path_that_is_no_regular_file_is_refused(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    for path, text in (
        (tmp_path, "a directory"), (tmp_path / "pipe", "no regular file"),
        ("/dev/null", "no regular file"), (tmp_path / "none" / "f", "does not exist: create it"),
        ("a\0b", "null"),
    ):  # fmt: skip
        with pytest.raises(JournalError, match=text):
            open_journal(str(path))


def test_a_file_that_may_not_be_written(tmp_path, monkeypatch):
    for number, text in (
        (errno.EACCES, "may not write"), (errno.EROFS, "read-only"), (errno.ENOSPC, "disk is full"),
        (errno.EIO, "Input/output"),
    ):  # fmt: skip

        def fails(*_args, number=number, **_more):
            raise OSError(number, os.strerror(number))

        with monkeypatch.context() as patch:
            patch.setattr(state.os, "open", fails)
            with pytest.raises(JournalError, match=text):
                open_journal(str(tmp_path / "f"))


def test_a_file_is_used_by_one_agent_at_a_time(tmp_path):
    path = str(tmp_path / "f")
    first = open_journal(path)
    with pytest.raises(JournalError, match="another agent uses it"):
        open_journal(path)
    assert first.rewrite({}, [])  # the name now belongs to another file
    with pytest.raises(JournalError, match="another agent uses it"):
        open_journal(path)
    os.unlink(path)
    second = open_journal(path)
    assert not first.rewrite({}, [])
    assert first.error == "another agent uses it now"
    second.close(False)
    first.close(False)
    open_journal(path).close(False)


def test_after_a_crash_of_the_machine_nothing_is_trusted(tmp_path, monkeypatch):
    path = tmp_path / "f"
    for clean in (False, True):
        file = open_journal(str(path))
        slot, records, _ = client(1).encode(1)
        assert file.rewrite({0: slot}, [bytes(records)], sync=True)
        file.close(clean)
        assert load(path)[1].trusted  # the machine has not restarted
        with monkeypatch.context() as patch:
            patch.setattr(state, "_boot_id", lambda: "another")
            assert load(path)[1].trusted == clean
            patch.setattr(state, "_boot_id", lambda: "")
            assert load(path)[1].trusted == clean


def test_a_huge_file_is_read_to_the_limit_only(tmp_path, monkeypatch):
    path = tmp_path / "f"
    fill(path, 1)
    os.truncate(path, 1 << 30)  # holes
    read = []
    pread = os.pread
    monkeypatch.setattr(state.os, "pread", lambda *args: read.append(pread(*args)) or read[-1])
    monkeypatch.setattr(state, "MAX_JOURNAL", 1 << 20)
    clients, content = load(path)
    assert sum(map(len, read)) < 2 << 20
    same(clients[1], 1)
    assert content.damaged == ["it has 1073741824 bytes"]


def test_an_incomplete_write_is_taken_back(tmp_path, monkeypatch):
    file = open_journal(str(tmp_path / "f"))
    assert file.rewrite({}, [])
    assert file.append(record(1, 1, b"one"))
    size = os.path.getsize(file.path)
    pwrite = os.pwrite
    room = [10]

    def short(fd, view, at):
        if not room[0]:
            raise OSError(errno.ENOSPC, "No space left on device")
        done = pwrite(fd, bytes(view)[: room[0]], at)
        room[0] -= done
        return done

    monkeypatch.setattr(state.os, "pwrite", short)
    assert not file.append(record(1, 2, b"two"))
    assert os.path.getsize(file.path) == size
    room[0] = 5000
    assert not file.rewrite({}, [record(1, 1, bytes(6000))])
    assert not os.path.exists(file.path + ".new")
    monkeypatch.undo()
    assert file.append(record(1, 2, b"two"))
    assert [entry[2] for entry in file.read().records] == [b"one", b"two"]
    file.close(False)


REAL = """
import resource, signal, sys
from uros.agent.persistence.journal import open_journal, record
file = open_journal(sys.argv[1])
assert file.rewrite({}, []), file.error
if sys.argv[2] != "disk":
    limit = int(sys.argv[2])
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
count = 0
while file.append(record(1, count + 1, bytes(1000))):
    count += 1
    assert count < 10000
print(file.error)
assert file.write_slot(4095, bytes(range(128))), "slots have their room"
assert not file.rewrite({}, [bytes(4 << 20)])
assert [it[1] for it in file.read().records] == list(range(1, count + 1)), count
print(count)
"""


def test_a_file_at_its_size_limit(tmp_path):
    """The kernel refuses to extend the file, by RLIMIT_FSIZE."""
    done = subprocess.run(
        [sys.executable, "-c", REAL, str(tmp_path / "f"), "1000000"],
        capture_output=True, text=True, timeout=30,
    )  # fmt: skip
    error, count = done.stdout.split("\n")[:2]
    assert "too large" in error and int(count) == (1000000 - 528384) // 1024, done.stderr


def test_a_real_full_disk(tmp_path):
    """A tmpfs of 1 MB in a mount namespace of its own, where the user may create one."""
    run = f"exec {sys.executable} -c '{REAL}' {tmp_path}/f disk"
    script = f"mount -t tmpfs -o size=1M none {tmp_path} && {run}"
    unshare = shutil.which("unshare")
    possible = (
        unshare
        and subprocess.run(
            [unshare, "-rm", "mount", "-t", "tmpfs", "none", str(tmp_path)], capture_output=True
        ).returncode
        == 0
    )
    if not possible:
        pytest.skip("not on this platform: mounting in a namespace of one's own")
    done = subprocess.run(
        [unshare, "-rm", "sh", "-c", script], capture_output=True, text=True, timeout=30
    )
    assert done.stdout.split("\n")[0] == "No space left on device", done.stderr
    assert int(done.stdout.split("\n")[1]) > 100


def test_a_new_file_has_no_content(tmp_path):
    file = open_journal(str(tmp_path / "f"))
    assert file.read() == JournalContent()
    file.close(True)
    assert resource.RLIMIT_FSIZE and signal.SIGXFSZ  # what the test above needs


# --- what seldom happens ----------------------------------------------------------------------


def failing(number=errno.EIO):
    def fails(*_args, **_more):
        raise OSError(number, os.strerror(number))

    return fails


def test_a_truncated_record_does_not_hide_others():
    cut = record(7, 1, bytes(1000))[: state.RECORD_SIZE + 5]
    assert records_in(cut + record(8, 1, b"sound")) == [(8, 1, b"sound")]


def test_a_machine_without_a_boot_id(tmp_path, monkeypatch):
    path = tmp_path / "f"
    monkeypatch.setattr(state, "_BOOT_ID", str(tmp_path / "nothing"))
    for clean in (False, True):
        file = open_journal(str(path))
        assert file.rewrite({}, [])
        file.close(clean)
        assert load(path)[1].trusted == clean


def test_a_disk_that_cannot_be_read(tmp_path, monkeypatch):
    fill(tmp_path / "f", 1)
    file = open_journal(str(tmp_path / "f"))
    with monkeypatch.context() as patch:
        patch.setattr(state.os, "pread", failing())
        content = file.read()
        assert content.damaged == ["it cannot be read: Input/output error"]
        assert not content.slots
    file.close(False)


def test_a_disk_that_writes_nothing_and_reports_no_error(tmp_path, monkeypatch):
    file = open_journal(str(tmp_path / "f"))
    assert file.rewrite({}, [])
    with monkeypatch.context() as patch:
        patch.setattr(state.os, "pwrite", lambda *_: 0)
        assert not file.append(record(1, 1, b"one"))
        assert file.error == "No space left on device"
        assert not file.write_slot(0, bytes(state.SLOT_SIZE))
        patch.setattr(state.os, "ftruncate", failing())
        assert not file.append(record(1, 1, b"one"))
        patch.setattr(state.os, "pwrite", failing())
        assert not file.write_slot(0, bytes(state.SLOT_SIZE))
        assert file.error == "Input/output error"
    assert file.append(record(1, 1, b"one"))
    assert file.read().records == [(1, 1, b"one")]
    file.close(False)


def test_a_damaged_file_that_cannot_be_renamed(tmp_path):
    file = open_journal(str(tmp_path / "f"))
    (tmp_path / "f.damaged").mkdir()
    assert file.keep_aside() is None
    file.close(False)


def test_a_system_without_preallocation(tmp_path, monkeypatch):
    """macOS."""
    monkeypatch.delattr(state.os, "posix_fallocate", raising=False)
    fill(tmp_path / "f", 1)
    assert os.path.getsize(tmp_path / "f") > state._JOURNAL_AT
    same(load(tmp_path / "f")[0][1], 1)


def test_the_size_of_a_journal_is_limited(tmp_path, monkeypatch):
    file = open_journal(str(tmp_path / "f"))
    half = record(1, 1, bytes(1 << 20))
    monkeypatch.setattr(state, "MAX_JOURNAL", 5 << 19)
    assert not file.rewrite({}, [half, half, half])
    assert "MB of state" in file.error
    assert os.path.getsize(tmp_path / "f") == 0
    assert file.rewrite({}, [half, half])
    assert not file.append(half)
    assert "MB of state" in file.error
    assert len(file.read().records) == 2
    file.close(True)


def test_a_directory_that_allows_no_rename_and_no_removal(tmp_path, monkeypatch):
    """Neither may the new file be renamed nor the incomplete one be removed."""
    fill(tmp_path / "f", 1)
    file = open_journal(str(tmp_path / "f"))
    with monkeypatch.context() as patch:
        patch.setattr(state.os, "replace", failing(errno.EACCES))
        patch.setattr(state.os, "unlink", failing(errno.ENOENT))
        assert not file.rewrite({}, [])
    assert file.error == "Permission denied"
    file.close(False)
    same(load(tmp_path / "f")[0][1], 1)
    assert (tmp_path / "f.new").exists()
    file = open_journal(str(tmp_path / "f"))
    assert file.rewrite({}, []) and not (tmp_path / "f.new").exists()
    file.close(False)


def test_outdated_content_is_removed_by_any_means_that_works(tmp_path, monkeypatch):
    fill(tmp_path / "f", 1)
    file = open_journal(str(tmp_path / "f"))
    with monkeypatch.context() as patch:
        patch.setattr(state.os, "ftruncate", failing())
        with monkeypatch.context() as more:
            more.setattr(state.os, "unlink", failing())
            file.clear()
        file.clear()
    assert not (tmp_path / "f").exists()
    file.close(False)

    fill(tmp_path / "f", 1)
    file = open_journal(str(tmp_path / "f"))
    file.clear()
    assert file.write_slot(7, bytes(state.SLOT_SIZE))
    assert (tmp_path / "f").read_bytes() == b""  # slots alone are no state file
    assert file.rewrite({}, []) and file.write_slot(7, b"x" * state.SLOT_SIZE)
    assert b"x" * state.SLOT_SIZE in (tmp_path / "f").read_bytes()
    file.close(False)


def test_a_file_that_cannot_be_checked_or_synchronized(tmp_path, monkeypatch):
    file = open_journal(str(tmp_path / "f"))
    assert file.rewrite({}, []) and file.missing() is None
    for call in ("stat", "pread"):
        with monkeypatch.context() as patch:
            patch.setattr(state.os, call, failing())
            assert file.missing() == "Input/output error"
    with monkeypatch.context() as patch:
        patch.setattr(state.os, "fsync", failing())
        file.close(True)  # it is trusted until the machine restarts
    file.close(True)
    assert load(tmp_path / "f")[1].trusted
    with monkeypatch.context() as patch:
        patch.setattr(state, "_boot_id", lambda: "another")
        assert not load(tmp_path / "f")[1].trusted


def test_a_system_without_file_locks(tmp_path, monkeypatch):
    monkeypatch.setattr(state, "fcntl", None)
    with pytest.raises(JournalError, match="systems with file locks"):
        open_journal(str(tmp_path / "f"))
    assert not (tmp_path / "f").exists()


def test_a_file_system_without_locks(tmp_path, monkeypatch):
    monkeypatch.setattr(state.fcntl, "flock", failing(errno.ENOLCK))
    with pytest.raises(JournalError, match="No locks available"):
        open_journal(str(tmp_path / "f"))


def test_a_file_that_changes_while_it_is_opened(tmp_path, monkeypatch):
    """Its owner replaces the file again and again, or ends and removes it."""
    path = tmp_path / "f"
    path.touch()
    stat, times = os.stat, []

    def renewed(name, *args, **more):
        times.append(name)
        if len(times) % 2 == 0:
            if len(times) == 4:
                raise FileNotFoundError
            return stat(tmp_path)
        return stat(name, *args, **more)

    with monkeypatch.context() as patch:
        patch.setattr(state.os, "stat", renewed)
        with pytest.raises(JournalError, match="another agent uses it"):
            open_journal(str(path))
    assert len(times) == 2 * state._TRIES

    # A pipe at first; after opening, the name belongs to something else.
    with monkeypatch.context() as patch:
        patch.setattr(state.os, "fstat", lambda _: stat("/dev/null"))
        with pytest.raises(JournalError, match="no regular file"):
            open_journal(str(path))
    open_journal(str(path)).close(False)  # no lock is left
