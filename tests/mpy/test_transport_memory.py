"""Tests of the heap that each transport takes on a board, beside a publishing node."""

import re
from pathlib import Path

import pytest
from mpy.harness import MicroPython, tree

from uros.boards.builder.file_system import build

PROGRAM = """
from uros.client import Node
{imports}

def run(port):
    node = Node("node", {transport})
    publisher = node.create_publisher(None, "topic", 10)
    node.create_timer(1.0, lambda: publisher.publish(None))
    node.spin()
"""
UDP = "from uros.transport.udp import UdpTransport\n"
OVER = UDP + "from uros.transport.wlan import Over, Station\n"
# The most that a size may differ from that on the page, in kB.
TOLERANCE = 0.15
# Bytes: today's cost and a tenth.
KINDS = {
    "udp": (UDP, "UdpTransport('h')", 1000),
    "wlan": (OVER, "Over(Station('s', 'p'), UdpTransport('h'))", 3400),
    "tcp": ("from uros.transport.tcp import TcpTransport", "TcpTransport('h')", 3400),
    "stream": ("from uros.transport.serial import StreamTransport", "StreamTransport(port)", 3000),
    "can": (
        "from uros.transport.can import CanTransport\nfrom uros.transport.can_pyb import PybCan",
        "CanTransport(PybCan(port))",
        2100,
    ),
    "esp8266": (
        "from uros.transport.esp8266 import Esp8266Transport",
        "Esp8266Transport(port, 's', 'p', 'h')",
        7500,
    ),
    "gs2200": (
        "from uros.transport.gs2200 import Gs2200Transport",
        "Gs2200Transport(port, port, 's', 'p', 'h')",
        8100,
    ),
}


def heap_of(folder, imports, transport):
    (folder / "program").mkdir(parents=True)
    (folder / "program" / "main.py").write_text(
        PROGRAM.format(imports=imports, transport=transport)
    )
    build(folder / "program", folder / "out", "mpy")
    with MicroPython() as board:
        # Ports with a network have socket built in, so that it takes no heap.
        board.write("/lib/socket.py", "SOCK_STREAM, SOCK_DGRAM, IPPROTO_TCP = 1, 2, 6\n")
        board.install(tree(folder / "out"))
        board.run("import array, errno, gc, os, select, socket, struct, sys, time")
        board.heap()
        before = board.heap()
        board.run("import uros._all")
        return board.heap() - before


@pytest.fixture(scope="module")
def bare(tmp_path_factory):
    """Return the heap of a node without a transport."""
    return heap_of(tmp_path_factory.mktemp("bare") / "bare", "", "port")


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_heap_of_a_transport(kind, bare, tmp_path):
    imports, transport, limit = KINDS[kind]
    cost = heap_of(tmp_path, imports, transport) - bare
    print(f"\n{kind}: {cost} bytes")
    assert 0 < cost <= limit
    assert abs(cost / 1000 - stated()[kind]) < TOLERANCE


def stated():
    """Return the sizes on the page of the transports, in kB, by kind."""
    page = (Path(__file__).parents[2] / "docs" / "board_transports.md").read_text("utf-8")
    rows = re.findall(r"^\| `\w+`[^|]* \| ([\d.]+) \|", page.partition("## Memory")[2], re.M)
    return dict(zip(KINDS, map(float, rows), strict=True))
