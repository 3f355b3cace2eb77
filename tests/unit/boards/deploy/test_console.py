"""Tests of the console text of a line that carries both printed text and XRCE frames."""

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from uros.boards.deploy.console import ConsoleText, Hints
from uros.wire.framing import frame, frame_size


def framed(payload: bytes, source: int = 1, target: int = 0) -> bytes:
    out = bytearray(frame_size(payload))
    return bytes(out[: frame(payload, source, target, out)])


def shown(data: bytes, size: int = 1) -> tuple[str, int]:
    text = ConsoleText()
    out = "".join(text.feed(data[at : at + size]) for at in range(0, len(data), size))
    while text.holding:
        out += text.flush()
    return out, text.frames


@pytest.mark.parametrize("size", [1, 2, 7, 1000])
def test_frames_are_removed_and_counted(size: int) -> None:
    data = b"one " + framed(b"\x80\x01~}x") + b"two\r\n" + framed(bytes(300), 2, 0) * 2 + b"three"
    assert shown(data, size) == ("one two\r\nthree", 3)


@pytest.mark.parametrize(
    "text", ["~", "~~~", "a ~ b", "~/file", "~ 21 °C\r\n", "x~", "~}", "~\x01\x00\x05\x00"]
)
def test_a_tilde_is_text(text: str) -> None:
    safe = "".join(
        character if character >= " " or character in "\r\n" else f"\\x{ord(character):02x}"
        for character in text
    )
    assert shown(text.encode()) == (safe, 0)


def test_a_damaged_frame_is_text_and_the_valid_frame_behind_it_is_not() -> None:
    damaged = bytearray(framed(b"reading"))
    damaged[-1] ^= 1
    text, frames = shown(bytes(damaged) + framed(b"reading") + b"ok")
    assert frames == 1 and "reading" in text and text.endswith("ok")


def test_control_characters_are_escaped() -> None:
    assert shown(b"\x1b[K\b\a\t\r\n") == ("\x1b[K\b\a\t\r\n", 0)
    assert shown(b"\x00\x0e\x7f\xff\xc2\x9b") == ("\\x00\\x0e\\x7f\ufffd\\x9b", 0)


@pytest.mark.parametrize("size", [1, 3, 100])
def test_only_line_editor_sequences_and_colors_pass(size: int) -> None:
    passing = b"\x1b[12D\x1b[K\x1b[3C\x1b[1;31mred\x1b[0m"
    assert shown(passing, size) == (passing.decode(), 0)
    harmful = b"\x1b[2J\x1b]0;title\x07\x1b[6n\x1b[21t\x1bc\x1bP\x1b[9999C\x1b"
    text = shown(harmful, size)[0]
    assert "\x1b" not in text and text.count("\\x1b") == harmful.count(b"\x1b")
    assert shown("a\u202eb\u200b".encode(), size) == ("a\\u202eb\\u200b", 0)


@given(st.binary(max_size=300), st.integers(1, 40))
@example(b"\x1b[1;1;1;1;1;1;1;1;1mx\x1b", 2)
def test_any_octets_in_any_pieces_give_the_same(data: bytes, size: int) -> None:
    assert shown(data, size) == shown(data, max(1, len(data)))


@given(st.lists(st.one_of(st.text(st.sampled_from("abc 1\n")), st.binary(max_size=80)), max_size=8))
def test_text_between_frames_is_unchanged(parts: list[str | bytes]) -> None:
    data = b"".join(part.encode() if isinstance(part, str) else framed(part) for part in parts)
    expected = "".join(part for part in parts if isinstance(part, str))
    assert shown(data, 5) == (expected, sum(isinstance(part, bytes) for part in parts))


def test_errors_that_need_an_explanation_get_it_once() -> None:
    hints = Hints()
    said = []
    text = "ok\r\nValueError: incompatible .mpy file\r\n" * 2 + "no module named 'secrets'\r\n"
    for letter in text:
        said += hints.feed(letter)
    assert len(said) == 2 and "another version" in said[0] and "--secrets FILE" in said[1]
    assert Hints().feed("no module named 'secret'") == []
