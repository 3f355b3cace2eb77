"""Tests that file systems of `uros.boards.builder.file_system` run on MicroPython."""

import re
import tempfile
import textwrap
from pathlib import Path

import pytest
from mpy.harness import MicroPython, portable_sources, portable_tests, shared_sources, tree
from mpy.measures import CORE
from support.variants import slow_except

from uros.boards.builder.file_system import build
from uros.boards.builder.pipeline import PASSES
from uros.interfaces import write_package

# Modules of a user's program that depend on what a translation may lose.
OWN = {
    "an attribute made of one that a subclass sets": """
        class Wheel:
            SPEED = 1.0
            LIMIT = SPEED * 2

        class Fast(Wheel):
            SPEED = 3.0

        print(Fast.SPEED, Fast.LIMIT)
        """,
    "two targets, one of them set by a subclass": """
        class Motor:
            REVERSE = FORWARD = 3

        class Geared(Motor):
            FORWARD = 5

        print(Geared.FORWARD, Geared.REVERSE)
        """,
    "a global that the called method's helper changes": """
        count = 0

        def more():
            global count
            count += 1

        class Counter:
            def __init__(self):
                self.seen = []

            def run(self):
                self.step(count)

            def step(self, now):
                more()
                self.seen.append(now)

        counter = Counter()
        counter.run()
        print(counter.seen, count)
        """,
    "a local of a method called in a loop, bound on a condition": """
        class Filter:
            def __init__(self):
                self.told = []

            def run(self, values):
                for value in values:
                    try:
                        self.look(value)
                    except NameError:
                        self.told.append("unbound")

            def look(self, value):
                if value > 1:
                    last = value
                self.told.append(last)

        instance = Filter()
        instance.run([1, 2, 1])
        print(instance.told)
        """,
}

PROGRAM = """
from sensor_msgs.msg import Imu, Temperature
from std_srvs.srv import Trigger
from uros.interfaces import InterfaceError
from uros.interfaces.codec import from_cdr, to_cdr
from uros.wire import ids
from uros.wire.framing import Deframer, frame, frame_size
from uros.wire.header import MessageWriter, pull_header, pull_subheader
from uros.wire.session import push_request


def publish(message):
    w = MessageWriter(bytearray(600), 0x81, ids.STREAM_RELIABLE, 7)
    w.begin(ids.WRITE_DATA)
    push_request(w, 10, 0x0015)
    w.start = w.offset
    w.offset = message.pack_into(w.buf, w.offset, w.offset)
    out = bytearray(frame_size(w.buf))
    return bytes(out[: frame(w.finish(), 1, 0, out)])


def main():
    reading = Temperature(temperature=21.5, variance=0.25)
    reading.header.frame_id = "room"
    reading.header.stamp.sec = 1700000000
    for message in (reading, Imu(), Trigger.Response(success=True, message="\\u00e9")):
        (datagram,) = Deframer(0).feed(publish(message))
        session, stream, sequence, key, at = pull_header(datagram, len(datagram))
        kind, flags, start, stop = pull_subheader(datagram, at, len(datagram))
        again = type(message).unpack_from(datagram, start + 4, start + 4, stop)[0]
        print(session, stream, sequence, key, kind, flags, datagram, again == message)
    print(reading, reading.get_fields_and_field_types())
    print(from_cdr(Temperature, to_cdr(reading)) == reading)
    for field in ("temperature", "header"):
        value = getattr(reading, field)
        setattr(reading, field, "warm")
        try:
            to_cdr(reading)
        except TypeError as error:
            print(error)
        setattr(reading, field, value)
    setattr(reading.header.stamp, "nanosec", -1)  # the build refuses a plain assignment
    try:
        to_cdr(reading)
    except InterfaceError as error:
        print(error)


main()
"""

MODEM = "support/modem.py"
WORDS = "terse-errors"
FORMS = [
    pytest.param({"without": [WORDS, "tree-shake"]}, id="text, nothing dropped"),
    pytest.param({"without": [WORDS]}, id="text"),
    pytest.param({"without": [WORDS, "bundle"], "form": "mpy"}, id="bytecode, a file a module"),
    pytest.param({"without": [WORDS], "form": "mpy"}, id="bytecode"),
]


@pytest.fixture(scope="module")
def expected() -> str:
    """Return the output of the program with the unchanged sources of uros, on MicroPython."""
    with MicroPython() as board, tempfile.TemporaryDirectory() as folder:
        types = ["sensor_msgs/Imu", "sensor_msgs/Temperature", "std_srvs/srv/Trigger"]
        write_package(types, folder)
        board.install(portable_sources())
        board.install(tree(Path(folder)))
        return board.run(PROGRAM)


@pytest.mark.parametrize("options", FORMS)
def test_a_program_does_the_same(
    micropython: MicroPython, tmp_path: Path, expected: str, options: dict
) -> None:
    program = tmp_path / "program"
    program.mkdir()
    (program / "main.py").write_text("import app\n", encoding="utf-8")
    (program / "app.py").write_text(PROGRAM, encoding="utf-8")
    build(program, tmp_path / "out", **options)
    micropython.install(tree(tmp_path / "out"))
    assert micropython.run("import main") == expected
    assert len(expected.splitlines()) == 8


@pytest.mark.parametrize("name", slow_except([step.name for step in PASSES], "bundle"))
def test_the_client_starts_without_a_pass(
    micropython: MicroPython, tmp_path: Path, name: str
) -> None:
    (tmp_path / "program").mkdir()
    (tmp_path / "program" / "app.py").write_text(CORE)
    build(tmp_path / "program", tmp_path / "out", "mpy", without=[name])
    micropython.install(tree(tmp_path / "out"))
    assert micropython.run("import app; print(app.Node is not None)") == "True\n"


@pytest.mark.parametrize("case", OWN)
def test_a_users_module_prints_the_same(
    micropython: MicroPython, tmp_path: Path, case: str
) -> None:
    """A user's module prints the same as text and in a default ``--mpy`` build."""
    text = textwrap.dedent(OWN[case])
    expected = micropython.run(text)
    # Names that main does not import are known to the module alone.
    *_, imported_name = re.findall(r"^(?:class )?([A-Za-z]\w+)(?: = |\W.*:$)", text, re.MULTILINE)
    program = tmp_path / "program"
    program.mkdir()
    (program / "main.py").write_text(f"from app import {imported_name}\n", encoding="utf-8")
    (program / "app.py").write_text(text, encoding="utf-8")
    build(program, tmp_path / "out", "mpy")
    with MicroPython() as board:
        board.install(tree(tmp_path / "out"))
        assert board.run("import main") == expected


def test_lean_errors_are_of_the_same_kind_and_name_the_type(
    micropython: MicroPython, tmp_path: Path, expected: str
) -> None:
    program = tmp_path / "program"
    program.mkdir()
    (program / "main.py").write_text("import app\n", encoding="utf-8")
    # With terse-errors, messages are equal only to themselves, and have no text form.
    text = PROGRAM.replace("again == message", "to_cdr(again) == to_cdr(message)")
    text = text.replace("    print(reading, reading.get_fields_and_field_types())\n", "")
    text = text.replace("to_cdr(reading)) == reading)", "to_cdr(reading)).temperature == 21.5)")
    (program / "app.py").write_text(text, encoding="utf-8")
    build(program, tmp_path / "out", form="mpy")
    micropython.install(tree(tmp_path / "out"))
    lines = micropython.run("import main").splitlines()
    assert lines[:-3] == expected.splitlines()[:3] + expected.splitlines()[4:-3]
    name = "sensor_msgs/msg/Temperature"
    assert "float" in lines[-3]
    assert lines[-2:] == [name, "Header"]


@pytest.mark.slow
@pytest.mark.timeout(300)  # a thousand tests in one interpreter
@pytest.mark.parametrize("options", [FORMS[0], FORMS[-1]])
def test_portable_tests_pass(micropython: MicroPython, tmp_path: Path, options: dict) -> None:
    """Portable tests pass as one program in one interpreter.

    Tests of modems are left out: they set a module's clock, which a bundle refuses.
    """
    program = tmp_path / "program"
    for path, text in shared_sources().items():
        if path == MODEM:
            continue
        (program / path).parent.mkdir(parents=True, exist_ok=True)
        (program / path).write_text(text, encoding="utf-8")
    tests = [test for test in portable_tests() if "support.modem" not in test[0].read_text("utf-8")]
    for file in {file for file, _ in tests}:
        (program / f"{module_name(file)}.py").write_bytes(file.read_bytes())
    build(program, tmp_path / "out", **options)
    micropython.install(tree(tmp_path / "out"))
    for file, function in tests:
        micropython.run(f"import {module_name(file)} as tests\ntests.{function}()")
    assert len(tests) > 100


EXACT = """
from nav_msgs.msg import Odometry
from sensor_msgs.msg import NavSatFix
from uros.client.float64 import Exact, Float64

value = Float64(501234567, 10000000)
fix, odometry = NavSatFix(), Odometry()
for exact in (
    Exact(fix, latitude=value), Exact(odometry, (odometry.pose.pose.position, "x", value))
):
    buf = bytearray(exact.cdr_size())
    exact.pack_into(buf, 0, 0)
    print(bytes.fromhex("6d7cdc6dcd0f4940") in bytes(buf))
"""


@pytest.mark.parametrize("form", ["py", "mpy"])
def test_exact_float64_fields(micropython: MicroPython, tmp_path: Path, form: str) -> None:
    (tmp_path / "program").mkdir()
    (tmp_path / "program" / "app.py").write_text(EXACT)
    build(tmp_path / "program", tmp_path / "out", form)
    micropython.install(tree(tmp_path / "out"))
    assert micropython.run("import app") == "True\nTrue\n"


def module_name(file: Path) -> str:
    """Return a module name that is unique where two folders have tests of the same name."""
    return f"{file.parent.name}_{file.stem}"
