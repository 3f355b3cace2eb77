"""Escaping of text from outside, and the stream that escapes a command's output."""

import io

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.screen import HOSTILE, UNENCODABLE, visible_lines

from uros.printable import (
    PrintableStream,
    guarded,
    is_printable,
    printable,
    printable_ascii,
    unguarded,
)


@pytest.mark.parametrize(
    "text", ["", "/left/room_temp", "12\xa0°C", "温度\u3000室", "grün 😀", "a\\x1b", "\u2009|"]
)
def test_text_stays_as_it_is(text):
    assert printable(text) == text and is_printable(text)


@pytest.mark.parametrize(
    ("text", "safe"),
    [
        ("a\x1b[2J", "a\\x1b[2J"),
        ("a\r\nb\tc", "a\\r\\nb\\tc"),
        ("\x9b\x85", "\\x9b\\x85"),
        ("\u202ex\u2066", "\\u202ex\\u2066"),
        ("\u2028\u2029", "\\u2028\\u2029"),
        ("\u200b\ufeff\u3164", "\\u200b\\ufeff\\u3164"),
        ("\udc80", "\\udc80"),
        ("\U000e0041", "\\U000e0041"),
    ],
)
def test_control_and_invisible_characters_are_escaped(text, safe):
    assert printable(text) == safe and not is_printable(text)
    assert printable_ascii(text) == safe


def test_allowed_characters_are_not_escaped():
    assert printable("a\nb\r", "\n") == "a\nb\\r"


@given(st.text(st.characters()))
def test_any_text_is_one_safe_line(text):
    for safe in (printable(text), printable_ascii(text)):
        assert len(visible_lines(safe)) == 1
    assert printable_ascii(text).isascii()
    assert printable(printable(text)) == printable(text)


def written(text, encoding="utf-8"):
    raw = io.BytesIO()
    stream = PrintableStream(io.TextIOWrapper(raw, encoding=encoding, newline=""))
    print(text, file=stream, flush=True)
    return raw.getvalue().decode(encoding)


def test_a_stream_passes_lines_and_tabs_and_escapes_the_rest():
    assert written("a\tb\nc\rd\x1b") == "a\tb\nc\\rd\\x1b\n"
    visible_lines(written(HOSTILE.replace("\n", "") + UNENCODABLE))


def test_a_stream_escapes_characters_outside_its_encoding():
    assert written("grün", "ascii") == "gr\\xfcn\n"


def test_a_stream_is_wrapped_once_and_can_be_unwrapped():
    raw = io.StringIO()
    stream = guarded(raw)
    assert guarded(stream) is stream and unguarded(stream) is raw and unguarded(raw) is raw
    stream.writelines(["a\x1b", "b"])
    assert raw.getvalue() == "a\\x1bb" and not stream.isatty()
