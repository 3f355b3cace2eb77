"""Memory of deleted clients is returned to the system."""

import subprocess
import sys

from uros.agent.malloc_trim import PAUSE, Heap

HOLES = """
import ctypes, os
from uros.agent.malloc_trim import Heap

libc = ctypes.CDLL(None)
libc.malloc.restype, libc.malloc.argtypes = ctypes.c_void_p, [ctypes.c_size_t]
libc.free.argtypes = [ctypes.c_void_p]


def resident():
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")


heap = Heap()
heap.trim()
before = resident()
blocks = [libc.malloc(3000) for _ in range(20_000)]
for block in blocks:
    ctypes.memset(block, 1, 3000)
for number, block in enumerate(blocks):
    if number % 100 != 99:
        libc.free(block)
held = resident() - before
heap.trim()
print(held, resident() - before)
"""


def test_free_memory_between_used_pages_is_returned():
    done = subprocess.run([sys.executable, "-c", HOLES], check=True, capture_output=True, text=True)
    held_bytes, remaining_bytes = map(int, done.stdout.split())
    assert held_bytes > 40_000_000 and remaining_bytes < 10_000_000, done.stdout


def test_the_heap_is_trimmed_a_pause_after_clients_left_and_not_without():
    heap, done = Heap(), []
    heap._trim = done.append
    for second in range(100):
        heap.check(float(second))
    assert not done
    heap.clients_left = True
    for second in range(100, 100 + 3 * int(PAUSE)):
        heap.check(float(second))
    assert len(done) == 1
    for second in range(200, 200 + 4 * int(PAUSE)):  # clients keep leaving
        heap.clients_left = True
        heap.check(float(second))
    assert 3 <= len(done) <= 5


def test_without_glibc_nothing_happens(monkeypatch):
    import ctypes

    monkeypatch.setattr(ctypes, "CDLL", lambda name: object())
    Heap().trim()


def test_deleting_a_client_is_reported_to_the_heap(desk, board):
    assert not desk.agent.heap.clients_left
    desk.agent.delete_client(board.key)
    assert desk.agent.heap.clients_left
