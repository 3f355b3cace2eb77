"""Tests of the cache of builds."""

import os
import shutil
import time
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from support.examples import examples
from support.variants import slow_except

from uros import interfaces
from uros.boards.builder import cache, file_system
from uros.boards.builder.file_system import build
from uros.boards.virtual.engine.runner import RunningBoard

PROGRAM = "import greeting\n\nprint(greeting.TEXT)\n"


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """The folder of the kept builds, empty."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "uros" / "builds"


@pytest.fixture
def program(tmp_path):
    folder = tmp_path / "program"
    folder.mkdir()
    (folder / "main.py").write_text(PROGRAM)
    (folder / "greeting.py").write_text('TEXT = "hello"\n')
    (folder / "numbers.txt").write_text("1 2 3")
    (folder / "secrets.py").write_text('PASSWORD = "first"\n')
    return folder


def contents(out):
    return {
        path.relative_to(out).as_posix(): path.read_bytes()
        for path in sorted(out.rglob("*"))
        if path.is_file()
    }


def no_build(*_):
    raise AssertionError("the program is built")


def test_an_equal_build_takes_the_files_of_the_first(program, tmp_path, monkeypatch):
    build(program, tmp_path / "plain")
    first = build(program, tmp_path / "first", cached=True)
    monkeypatch.setattr(file_system, "_files", no_build)
    second = build(program, tmp_path / "second", cached=True)
    assert contents(tmp_path / "first") == contents(tmp_path / "plain")
    assert contents(tmp_path / "second") == contents(tmp_path / "plain")
    assert [path.name for path in first] == [path.name for path in second]


def test_a_build_that_is_asked_for_uses_no_cache(program, tmp_path, folder):
    build(program, tmp_path / "out")
    assert not folder.exists()


def change_a_file(program):
    (program / "greeting.py").write_text('TEXT = "HELLO"\n')


def change_data(program):
    (program / "numbers.txt").write_text("1 2 4")


def add_a_file(program):
    (program / "other.py").write_text("")


def rename_a_file(program):
    (program / "numbers.txt").rename(program / "figures.txt")


@pytest.mark.parametrize("change", [change_a_file, change_data, add_a_file, rename_a_file])
def test_a_change_of_the_program_is_another_build(program, tmp_path, change):
    build(program, tmp_path / "first", cached=True)
    change(program)
    build(program, tmp_path / "second", cached=True)
    build(program, tmp_path / "plain")
    assert contents(tmp_path / "second") == contents(tmp_path / "plain")
    assert contents(tmp_path / "second") != contents(tmp_path / "first")


def test_other_secrets_are_no_other_build(program):
    before = cache.key(program, ())
    (program / "secrets.py").write_text('PASSWORD = "second"\n')
    assert before is not None and cache.key(program, ()) == before


@pytest.mark.parametrize(
    "options",
    [
        {"form": "mpy"},
        {"without": ["terse-errors"]},
        {"roots": ["uros.wire.session"]},
        {"checked": True},
    ],
    ids=str,
)
def test_other_options_are_another_build(program, tmp_path, options):
    (program / "main.py").write_text("from std_msgs.msg import Int32\n")
    build(program, tmp_path / "first", cached=True)
    build(program, tmp_path / "second", cached=True, **options)
    build(program, tmp_path / "plain", **options)
    assert contents(tmp_path / "second") == contents(tmp_path / "plain")
    assert contents(tmp_path / "second") != contents(tmp_path / "first")


def test_a_module_that_the_board_does_not_have_is_missed_with_a_cache(program, tmp_path):
    (program / "main.py").write_text("import other\n")
    build(program, tmp_path / "first", provided=["other"], cached=True)
    with pytest.raises(file_system.BuildError, match="no module other"):
        build(program, tmp_path / "second", cached=True)


def test_other_definitions_and_distributions_are_another_build(program, tmp_path, monkeypatch):
    definitions = tmp_path / "our_msgs" / "msg"
    definitions.mkdir(parents=True)
    (definitions / "Number.msg").write_text("int32 data\n")
    keys = [cache.key(program, ())]
    monkeypatch.setenv("ROS_DISTRO", "humble")
    keys.append(cache.key(program, ()))
    monkeypatch.setenv("UROS_INTERFACES", str(tmp_path / "our_msgs"))
    keys.append(cache.key(program, ()))
    (definitions / "Number.msg").write_text("int64 data\n")
    keys.append(cache.key(program, ()))
    assert None not in keys and len(set(keys)) == len(keys)
    monkeypatch.setenv("UROS_INTERFACES", str(tmp_path / "nowhere"))
    with pytest.raises(interfaces.InterfaceError, match="UROS_INTERFACES"):
        cache.key(program, ())


def test_a_change_of_uros_is_another_build(program, tmp_path, monkeypatch):
    package = tmp_path / "uros"
    (package / "__pycache__").mkdir(parents=True)
    (package / "module.py").write_text("a = 1\n")
    monkeypatch.setattr(cache, "_PACKAGE", package)
    before = cache.key(program, ())
    (package / "__pycache__" / "module.pyc").write_bytes(b"compiled")
    assert cache.key(program, ()) == before
    os.utime(package / "module.py", (1, 1))
    assert before is not None and cache.key(program, ()) != before


def test_builds_with_an_installed_ros_are_not_kept(program, tmp_path, folder, monkeypatch):
    (tmp_path / "ros" / "share").mkdir(parents=True)
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "ros"))
    build(program, tmp_path / "out", cached=True)
    assert (tmp_path / "out" / "main.py").exists() and not folder.exists()


@pytest.fixture(scope="module")
def archive(tmp_path_factory):
    """The bytes of a kept build with files of all kinds, and these files."""
    home = tmp_path_factory.mktemp("archive")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(home))
        cache.write("key", {"main.py": b"print(1)\n", "lib/x.mpy": bytes(range(256)), "empty": b""})
        return (cache.folder() / "key.build").read_bytes(), cache.read("key")


@settings(max_examples=examples(200), suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_a_damaged_build_is_none(archive, data):
    """Any cut or changed byte of a kept build is noticed, and the program is built again."""
    whole, files = archive
    at = data.draw(st.integers(0, len(whole) - 1))
    damaged = whole[:at]
    if data.draw(st.booleans()):
        damaged += bytes([whole[at] ^ data.draw(st.integers(1, 255))]) + whole[at + 1 :]
    cache.folder().mkdir(parents=True, exist_ok=True)
    (cache.folder() / "damaged.build").write_bytes(damaged)
    found = cache.read("damaged")
    assert files and found is None


def test_a_damaged_archive_is_built_again(program, tmp_path, folder):
    build(program, tmp_path / "first", cached=True)
    (archive,) = folder.iterdir()
    files = cache.read(archive.stem)
    archive.write_bytes(archive.read_bytes()[:100])
    build(program, tmp_path / "second", cached=True)
    assert contents(tmp_path / "second") == contents(tmp_path / "first")
    assert files and cache.read(archive.stem) == files


def test_a_folder_that_cannot_be_written_is_no_fault(program, tmp_path, folder):
    folder.parent.parent.write_text("a file where a folder should be")
    build(program, tmp_path / "out", cached=True)
    assert (tmp_path / "out" / "main.py").exists()


def test_a_user_without_a_home_folder_builds_each_time(program, tmp_path, monkeypatch):
    def no_home():
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setattr(Path, "home", no_home)
    build(program, tmp_path / "out", cached=True)
    assert (tmp_path / "out" / "main.py").exists()


def test_a_host_whose_clock_was_never_set_keeps_builds(folder, monkeypatch):
    monkeypatch.setattr(time, "time", lambda: 10.0)
    monkeypatch.setattr(time, "localtime", lambda *_: time.gmtime(10.0))
    cache.write("key", {"main.py": b"print(1)\n"})
    assert cache.read("key") == {"main.py": b"print(1)\n"}


def test_the_builds_that_were_used_last_are_kept(folder, monkeypatch):
    monkeypatch.setattr(cache, "MOST", 2)
    for number, name in enumerate(["first", "second"]):
        cache.write(name, {"main.py": name.encode()})
        os.utime(folder / f"{name}.build", (number, number))
    assert cache.read("first") is not None
    cache.write("third", {})
    assert sorted(path.stem for path in folder.iterdir()) == ["first", "third"]


@pytest.mark.long
@pytest.mark.parametrize("form", slow_except(["py", "mpy"], "mpy"))
def test_a_virtual_board_starts_with_the_files_of_the_build_before(program, folder, form):
    """The second board runs what the archive has, and so says what was put into it."""
    with RunningBoard(program, "esp32_publisher", form=form, engine="micropython") as board:
        board.wait("hello")
    (archive,) = folder.iterdir()
    files = cache.read(archive.stem)
    assert files is not None
    cache.write(archive.stem, {**files, "main.py": b'print("from the archive")\n'})
    with RunningBoard(program, "esp32_publisher", form=form, engine="micropython") as board:
        board.wait("from the archive")
    shutil.rmtree(folder)
    with RunningBoard(program, "esp32_publisher", form=form, engine="micropython") as board:
        board.wait("hello")
