"""``uros board deploy`` and its parts, with a board at the other end that says anything."""

import hashlib
import json
from contextlib import closing

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from support.examples import examples
from support.lying_board import BANNER, GONE, SILENCE, Endless, LyingBoard, QuickTime
from support.screen import HOSTILE, visible_lines

from uros.boards.deploy import raw_repl
from uros.boards.deploy.deploy import NOTE, STAGE
from uros.boards.deploy.raw_repl import LineLost, RawRepl, Seconds
from uros.tools import cli
from uros.transport.serial_host import device_port

OLD = {"main.py": b"print('old')\n", "part.py": b"NUMBER = 1\n", "calibration.txt": b"3",
       NOTE: b"main.py\npart.py"}  # fmt: skip
NEW = {"main.py": "print('new')\n", "part.py": f"NUMBER = {'2' * 300}\n", "lib/more.py": "A = 1\n"}
STEPS = ("banner", "reboot", "again", "paste", "window", "credit", "heard", "output", "error",
         "prompt", "friendly")  # fmt: skip


@pytest.fixture
def program(tmp_path):
    """A folder as `uros board build` writes them: it is copied as it is."""
    for path, text in NEW.items():
        file = tmp_path / "program" / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
    return tmp_path / "program"


@pytest.fixture
def deploy(program, monkeypatch, capsys):
    """Deploys to a board; the exit status, and what was said, which a terminal may show."""
    monkeypatch.setattr("uros.boards.builder.output.is_built", lambda path: True)

    def run(board, *options):
        with monkeypatch.context() as patches:
            QuickTime(board, patches)
            return judged(board, options)

    def judged(board, options):
        arguments = ["board", "deploy", str(program), "--port", board.path, "--no-console"]
        status = cli.main([*arguments, *options])
        said = capsys.readouterr()
        visible_lines(said.out)
        visible_lines(said.err)
        assert status in (0, 1)
        if status:
            *reset, last = said.err.splitlines()
            assert last.startswith(f"uros: {board.path}: ") and len(last) < 1000
            assert all("press its reset button now" in line for line in reset) and len(reset) <= 1
        return status, said

    return run


def untouched(board):
    """Whether the board has what it had, besides the folder for new files."""
    return {path: data for path, data in board.files.items() if not path.startswith(STAGE)} == OLD


def deployed(board):
    return {path: board.files.get(path) for path in NEW} == {
        path: text.encode() for path, text in NEW.items()
    }


def check(deploy, lie):
    """A lie ends with success or a named error, and never with half of the new files."""
    with LyingBoard(lie, OLD) as board:
        status, said = deploy(board)
    assert deployed(board) if status == 0 else untouched(board) or deployed(board), board.files
    return status, said.err


def test_a_correct_board_gets_the_new_files(deploy):
    with LyingBoard(files=OLD) as board:
        status, said = deploy(board, "--json")
    assert status == 0 and deployed(board) and board.files["calibration.txt"] == b"3"
    assert set(json.loads(said.out)["copied"]) == set(NEW)
    assert set(board.steps) == set(STEPS)


# --- each step, each kind of lie ------------------------------------------------------------------

KINDS = {
    "silence": lambda honest: SILENCE,
    "unplugged": lambda honest: GONE,
    "nothing at all": lambda honest: b"",
    "0x01 without end": lambda honest: Endless(b"\x01"),
    "0x04 without end": lambda honest: Endless(b"\x04"),
    "text without end": lambda honest: Endless(b"21.5 C\r\n"),
    "zeros without end": lambda honest: Endless(b"\0"),
    "the answer without end": lambda honest: Endless(honest),
    "half of it": lambda honest: honest[: len(honest) // 2],
    "twice": lambda honest: honest * 2,
    "0xff in its place": lambda honest: b"\xff" * len(honest),
    "no UTF-8 before it": lambda honest: b"\xff\xfe\xc3(" + honest,
    "escapes before it": lambda honest: HOSTILE.encode() + honest,
    "what it was sent": lambda honest: b"\x05A\x01import os" + honest,
    "another prompt": lambda honest: b">>> " + honest,
    "an exception": lambda honest: b"\x04OSError: \x1b[2J 28\x04>",
    "hex": lambda honest: honest.hex().encode(),
    "100 kB before it": lambda honest: b"x" * 100_000 + honest,
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("step", STEPS)
def test_a_wrong_answer_at_a_step_is_named(step, kind, deploy):
    def lie(at, count, honest):
        return KINDS[kind](honest) if at == step and count != 1 else honest

    check(deploy, lie)


@pytest.mark.parametrize("code", [1, 3, 6, 9, 14, 19, 21])
@pytest.mark.parametrize("kind", ["silence", "unplugged", "half of it"])
def test_a_board_that_fails_at_any_code_keeps_its_files(code, kind, deploy):
    def lie(step, count, honest):
        return KINDS[kind](honest) if (step, count) == ("output", code) else honest

    check(deploy, lie)


@pytest.mark.parametrize(
    ("window", "said"),
    [(b"\0\0", "a window of 0 octets"), (b"\1\0", ""), (b"\xff\xff", "")],
)  # fmt: skip
def test_a_window_of_any_size(window, said, deploy):
    status, error = check(
        deploy, lambda step, count, honest: window if step == "window" else honest
    )
    if said:
        assert status == 1 and said in error and "reset button" in error


def test_room_without_end_is_named(deploy):
    def lie(step, count, honest):
        return Endless(b"\x01") if step == "credit" else honest

    status, error = check(deploy, lie)
    assert status == 1 and "asks for more and more code, and reads none" in error


def test_an_incomplete_answer_is_waited_for_and_named(deploy):
    def lie(step, count, honest):
        return {"paste": b"R", "window": SILENCE}.get(step, honest)

    status, error = check(deploy, lie)
    assert status == 1 and "stopped answering (b'R' was the last)" in error


def test_an_endless_answer_is_truncated(deploy, monkeypatch):
    monkeypatch.setattr(raw_repl, "MAX_ANSWER", 50_000)

    def lie(step, count, honest):
        return Endless(b"x" * 1000) if (step, count) == ("output", 2) else honest

    status, error = check(deploy, lie)
    assert status == 1 and "its answer has more than 50000 octets" in error


def test_a_board_that_answers_just_in_time_forever_is_given_up():
    with LyingBoard(files=OLD) as board, closing(device_port(board.path)) as port:
        port.open()
        with pytest.raises(LineLost, match="over 0 s for its answers"):
            RawRepl(port, Seconds(whole=0.0)).enter()


# --- answers that are no answers --------------------------------------------------------------

ANSWERS = [
    "", "None", "()", "[]", "1", "'x'", "{}", "nan", "[None]", "[1, 2, 3]", "['a'", "('a',)",
    "[[['main.py']]]", "[" * 5000, "1+" * 3000 + "1", "9" * 5000, "'\\x1b[2J'", "'\\ud800'",
    "('micropython', '1.27', 'liar', 'x', 6, '/', (0, 0), True)",
    "('micropython', '1.27', 'liar', 'x', 6, '/', (-4096, 10), True)",
    "('micropython', '1.27', 'liar', 'x', 6, '/', (4096, 10, 3), True)",
    "('micropython', '1.27', 'liar', 'x', '6', '/', (4096, 1000), True)",
    "('micropython', '1.27', 'liar', 7, 6, '/', None, True)",
    "('micropython', '1.27', 'liar', 'x', 6, '/', None, 1)",
    "('micropython', '1.27', 'liar', '" + "x" * 5000 + "', 6, '/', None, True)",
    "('micropython', '1.27', 'liar', '\\x1b[2J\\u202e\\r\\nFORGED', 6, '/', None, True)",
    "('\\x1b[2J', '1.27', 'liar', 'x', 6, '/', None, True)",
    "['" + hashlib.sha256(b"").hexdigest() + "'] * 3",
    "['../../etc/passwd', '/', '', '..', 'main.py/', '\\x00', '\\n']",
]  # fmt: skip


@pytest.mark.parametrize("answer", ANSWERS, ids=lambda text: text[:24])
def test_an_answer_of_a_different_kind_is_named(answer, deploy):
    for code in (2, 3, 4, 5):

        def lie(step, count, honest, code=code):
            return answer.encode() + b"\r\n\x04" if (step, count) == ("output", code) else honest

        check(deploy, lie)


@pytest.mark.parametrize("right", [True, False])
def test_wrong_hashes(right, deploy):
    """That everything is there already, or that nothing ever arrives."""
    hashes = [hashlib.sha256(NEW[path].encode()).hexdigest() for path in sorted(NEW)]

    def lie(step, count, honest):
        if step == "output" and honest.startswith((b"['", b"'")) and len(honest) > 60:
            return repr(hashes if right else ["0" * 64] * 3).encode() + b"\r\n\x04"
        return honest

    with LyingBoard(lie, OLD) as board:
        status, said = deploy(board)
    assert untouched(board) or status == 0
    if not right:
        assert status == 1


# --- and all others ------------------------------------------------------------------------------

octets = st.one_of(
    st.binary(max_size=60),
    st.lists(
        st.sampled_from(
            [b"R\x01", b"R\x00", b"\x01", b"\x04", b">", b"OK", b">>> ", BANNER, b"soft reboot\r\n",
             b"\x80\x00", b"\x00\x00", b"Traceback", b"[]", b"''", b"\x1b[2J", b"\xff"]
        ),
        max_size=8,
    ).map(b"".join),
)  # fmt: skip


@settings(max_examples=examples(25), suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.dictionaries(st.tuples(st.sampled_from(STEPS), st.integers(0, 20)), octets, max_size=4))
def test_any_wrong_answers(deploy, lies):
    check(deploy, lambda step, count, honest: lies.get((step, count), honest))
