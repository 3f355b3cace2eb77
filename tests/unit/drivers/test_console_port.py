"""The console's line as the line to the agent: frames pass, Ctrl-C outside of them interrupts."""

import importlib
import os
import sys
from types import ModuleType

import pytest

from uros.wire.framing import Deframer, frame, frame_size


class Console:
    """A console with input and output as pipes, and what Ctrl-C is set to."""

    def __init__(self, monkeypatch):
        micropython = ModuleType("micropython")
        self.interrupts = []
        micropython.kbd_intr = self.interrupts.append
        monkeypatch.setitem(sys.modules, "micropython", micropython)
        module = importlib.import_module("uros.drivers.console_port")
        monkeypatch.setattr(module, "micropython", micropython)
        self.ends = [*os.pipe(), *os.pipe()]
        self.buffer = open(self.ends[0], "rb", buffering=0, closefd=False)
        output = ModuleType("output")
        output.buffer = open(self.ends[3], "wb", buffering=0, closefd=False)
        self.port = module.ConsolePort(self, output)
        self.port.open()

    def fileno(self):
        return self.ends[0]

    def type(self, data):
        os.write(self.ends[1], data)

    def close(self):
        for end in self.ends:
            os.close(end)


@pytest.fixture
def console(monkeypatch):
    opened = Console(monkeypatch)
    yield opened
    opened.close()


def framed(payload, source=0):
    out = bytearray(frame_size(payload))
    return bytes(out[: frame(payload, source, 1, out)])


EVERYTHING = bytes(range(256)) * 2 + b"\x03" * 9


@pytest.mark.parametrize("size", [1, 7, 4096])
def test_frames_with_any_octets_pass(console, size):
    data = framed(EVERYTHING) + framed(b"\3\3~}") + framed(b"\3" * 3)
    console.type(data)
    received = b""
    while piece := console.port.read(size):
        assert len(piece) <= size
        received += piece
    assert received == data
    assert Deframer(1).feed(received) == [EVERYTHING, b"\3\3~}", b"\3" * 3]
    assert console.interrupts == [-1] and console.port.read(10) is None


@pytest.mark.parametrize(
    "before",
    [b"", b"text ~ more", framed(b"\3"), framed(b"x") + b"~", b"~~~\r", b"~\0\1\xff\xff", b"~\r\3"],
)
def test_ctrl_c_outside_of_frames_interrupts_and_gives_the_line_back(console, before):
    console.type(before + b"\x03")
    with pytest.raises(KeyboardInterrupt):
        for _ in range(2):
            console.port.read(4096)
    assert console.interrupts == [-1, 3]


def test_a_frame_that_never_ends_holds_ctrl_c_back_for_its_length_only(console):
    console.type(framed(bytes(100))[:50] + b"\r\3\3" * 30)
    with pytest.raises(KeyboardInterrupt):
        console.port.read(4096)


def test_output_is_written_as_it_is_and_waiting_ends_with_input(console):
    assert console.port.write(memoryview(b"~\3\n")) == 3
    assert os.read(console.ends[2], 10) == b"~\3\n"
    console.type(b"x")
    console.port.wait(60_000)
    assert console.port.read(10) == b"x"
    console.port.close()
    assert console.interrupts == [-1, 3]
