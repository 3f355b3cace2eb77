"""Tests of the harness: its results, its errors and its measures."""

import re

import pytest
from mpy.harness import MicroPython, MicroPythonError, portable_sources


def test_returns_what_was_printed(micropython: MicroPython) -> None:
    assert micropython.run("x = 'é'\nprint(x, end='')") == "é"
    assert micropython.run("print(x)") == "é\n"


def test_it_is_the_pinned_micropython(micropython: MicroPython) -> None:
    out = micropython.run("import sys; print(sys.implementation[0], sys.implementation[1][:2])")
    assert out == "micropython (1, 27)\n"


def test_raises_with_traceback_and_output(micropython: MicroPython) -> None:
    micropython.write("/lib/broken.py", "def fail():\n    print('before')\n    assert 1 == 2\n")
    with pytest.raises(MicroPythonError) as caught:
        micropython.run("import broken\nbroken.fail()")
    assert 'broken.py", line 3' in str(caught.value)
    assert "AssertionError" in str(caught.value)
    assert str(caught.value).endswith("before")
    assert micropython.run("print('still here')") == "still here\n"


def test_a_lost_process_is_an_error(micropython: MicroPython) -> None:
    with pytest.raises(MicroPythonError, match="ended without an answer"):
        micropython.run("import js; js.process.exit(3)")


def test_heap_counts_what_is_alive(micropython: MicroPython) -> None:
    micropython.run("import gc")
    before = micropython.heap()
    micropython.run("kept = bytearray(10000)\nbytearray(50000)")
    assert 10000 <= micropython.heap() - before < 10500
    micropython.run("del kept")
    assert abs(micropython.heap() - before) < 500


def test_portable_sources_returns_the_files_or_the_changed_texts() -> None:
    as_is = portable_sources()
    assert as_is["uros/__init__.py"] == ""
    assert "uros/wire/__init__.py" in as_is
    changed = portable_sources(change=lambda text: text + "# changed\n")
    assert changed.keys() == as_is.keys()
    assert all(text.endswith("# changed\n") for path, text in changed.items() if "wire" in path)


def test_every_portable_module_imports(micropython: MicroPython) -> None:
    sources = portable_sources()
    micropython.install(sources)
    for path, text in sources.items():
        name = path.removesuffix(".py").removesuffix("/__init__").replace("/", ".")
        output = micropython.run(
            f"try:\n    import {name}\nexcept ImportError as error:\n    print(error)"
        )
        # Drivers fail at a module that this port of MicroPython lacks, and at nothing else.
        absent = re.search(r"^(?:from|import) (machine|usb|socket|ssl)\b", text, re.M)
        assert output == (f"no module named '{absent[1]}'\n" if absent else ""), name
