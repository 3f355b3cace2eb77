import io
import os
import threading
from contextlib import redirect_stdout

import pytest

from uros.tools.topic.output import Output


@pytest.fixture
def pipe():
    """An output into a pipe, and the descriptor of its reader."""
    reader, writer = os.pipe()
    with os.fdopen(writer, "w", encoding="utf-8") as stream:
        with redirect_stdout(stream):
            out = Output()
        yield out, reader
    os.close(reader)


def test_text_is_escaped_and_waits_for_a_flush(pipe):
    out, reader = pipe
    out.write("a\tü\x1b[2J\n")
    assert out.waiting and not out.full
    out.flush()
    assert not out.waiting
    assert os.read(reader, 100).decode() == "a\tü\\x1b[2J\n"


def test_a_full_pipe_does_not_block(pipe):
    out, reader = pipe
    line = "x" * 99 + "\n"
    count = 0
    while not out.full:
        out.write(line)
        out.flush()
        count += 1
    out.flush(0.01)
    assert out.waiting
    sent = bytearray()

    def read():
        while len(sent) < count * len(line):
            sent.extend(os.read(reader, 1 << 16))

    thread = threading.Thread(target=read)
    thread.start()
    out.flush(None)  # waits for the reader
    assert not out.waiting
    thread.join()
    assert sent == line.encode() * count


def test_a_reader_that_is_gone_is_an_error():
    reader, writer = os.pipe()
    os.close(reader)
    with os.fdopen(writer, "w", encoding="utf-8") as stream:
        with redirect_stdout(stream):
            out = Output()
        out.write("a\n")
        with pytest.raises(BrokenPipeError):
            out.flush()


def test_where_there_is_no_file_text_is_written_at_once():
    stream = io.TextIOWrapper(io.BytesIO(), "ascii", errors="backslashreplace")
    with redirect_stdout(stream):
        out = Output()
    out.write("grün\n")
    out.flush()
    assert stream.buffer.getvalue() == b"gr\\xfcn\n" and not out.waiting
