"""The lock of a file that one agent writes."""

import errno
import os

import pytest

from uros import file_lock


@pytest.fixture
def descriptors(tmp_path):
    """Two descriptors of one file, each opened for itself."""
    path = tmp_path / "file"
    path.touch()
    both = [os.open(path, os.O_RDWR) for _ in range(2)]
    yield both
    for file in both:
        os.close(file)


def test_the_second_is_refused_until_the_first_is_closed(descriptors, tmp_path):
    first = os.open(tmp_path / "file", os.O_RDWR)
    file_lock.lock(first)
    with pytest.raises(BlockingIOError):
        file_lock.lock(descriptors[0])
    os.close(first)
    file_lock.lock(descriptors[0])


def test_without_locks_both_may_write(descriptors, monkeypatch):
    class NoLocks:
        LOCK_EX = LOCK_NB = 0

        @staticmethod
        def flock(file, flags):
            raise OSError(errno.ENOLCK, "No locks available")

    for module in (NoLocks, None):
        monkeypatch.setattr(file_lock, "fcntl", module)
        for file in descriptors:
            file_lock.lock(file)
