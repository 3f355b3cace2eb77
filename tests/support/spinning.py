"""Nodes and networks that spin in a thread beside the test."""

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


@contextmanager
def spinning_network(network):
    """Spin a `uros.host.network.Network` in a thread until the end of the block, and close it.

    One that does not spin is not discovered whole: a listing waits for it until its time is over.
    """
    end = threading.Event()
    with network:

        def work():
            while not end.is_set():
                network.spin(end.is_set, 0.05)

        thread = threading.Thread(target=work, daemon=True)
        thread.start()
        try:
            yield network
        finally:
            end.set()
            thread.join()
