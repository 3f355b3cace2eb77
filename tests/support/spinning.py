"""A node that spins in a thread beside the test."""

import threading
from contextlib import contextmanager


@contextmanager
def spinning(node):
    """Spin the node in a thread until the end of the block."""
    end = threading.Event()
    failed = []

    def work():
        try:
            while not end.is_set():
                node.spin_once(0.02)
            node.destroy_node()
        except BaseException as error:
            failed.append(error)

    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    try:
        yield node
    finally:
        end.set()
        thread.join()
    assert not failed, failed
