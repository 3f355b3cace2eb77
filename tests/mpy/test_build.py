"""File systems made by `uros.boards.build`, on MicroPython: smaller, and otherwise the same."""

import tempfile
from pathlib import Path

import pytest
from mpy.harness import MicroPython, portable_sources, portable_tests, shared_sources, tree

from uros.boards.build import build
from uros.interfaces import write_package

PROGRAM = '''
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
        kept = getattr(reading, field)
        setattr(reading, field, "warm")
        try:
            to_cdr(reading)
        except TypeError as error:
            print(error)
        setattr(reading, field, kept)
    reading.header.stamp.nanosec = -1
    try:
        to_cdr(reading)
    except InterfaceError as error:
        print(error)


main()
'''

FORMS = [
    pytest.param({"lean": False, "shake": False}, id="text, nothing dropped"),
    pytest.param({"lean": False}, id="text"),
    pytest.param({"lean": False, "form": "mpy", "bundle": False}, id="bytecode, a file a module"),
    pytest.param({"lean": False, "form": "mpy"}, id="bytecode"),
]


@pytest.fixture(scope="module")
def expected() -> str:
    """What the program prints with uros as it is, on MicroPython."""
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


def test_lean_errors_are_of_the_same_kind_and_name_the_type(
    micropython: MicroPython, tmp_path: Path, expected: str
) -> None:
    program = tmp_path / "program"
    program.mkdir()
    (program / "main.py").write_text("import app\n", encoding="utf-8")
    # Messages of a lean build are equal only to themselves, and have no text.
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


@pytest.mark.parametrize("options", [FORMS[0], FORMS[-1]])
def test_portable_tests_pass(micropython: MicroPython, tmp_path: Path, options: dict) -> None:
    """All portable tests, as one program, in one interpreter; but those of modems, which change a
    module's clock: in a bundle no module has its own."""
    program = tmp_path / "program"
    for path, text in shared_sources().items():
        (program / path).parent.mkdir(parents=True, exist_ok=True)
        (program / path).write_text(text, encoding="utf-8")
    tests = [it for it in portable_tests() if "support.modem" not in it[0].read_text("utf-8")]
    for file in {file for file, _ in tests}:
        (program / f"{module_name(file)}.py").write_bytes(file.read_bytes())
    build(program, tmp_path / "out", **options)
    micropython.install(tree(tmp_path / "out"))
    for file, function in tests:
        micropython.run(f"import {module_name(file)} as tests\ntests.{function}()")
    assert len(tests) > 100


def module_name(file: Path) -> str:
    """Two folders may have tests of the same name."""
    return f"{file.parent.name}_{file.stem}"
