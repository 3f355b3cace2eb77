"""Compression of chunks, with the packages that there are."""

import sys

import pytest
from packaging.requirements import Requirement
from support.paths import ROOT

from uros.bag import compression
from uros.bag.errors import BagError
from uros.bag.writer import BagWriter

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

DATA = bytes(range(256)) * 5000


@pytest.mark.parametrize("name", compression.NAMES)
def test_what_is_compressed_is_decompressed(name):
    data = compression.compressor(name)(DATA)
    assert len(data) < len(DATA)
    assert b"".join(compression.decompressed(name, data, len(DATA) + 1)) == DATA


@pytest.mark.parametrize("name", compression.NAMES)
def test_no_more_is_decompressed_than_is_wanted(name):
    data = compression.compressor(name)(bytes(100 << 20))
    parts = list(compression.decompressed(name, data, 5000))
    assert sum(map(len, parts)) == 5000


@pytest.mark.parametrize("name", compression.NAMES)
def test_damaged_data_are_broken(name):
    with pytest.raises(compression.Broken):
        list(compression.decompressed(name, b"not compressed" * 9, 100))


@pytest.mark.parametrize("name", compression.NAMES)
def test_the_error_names_the_package_that_is_missing(tmp_path, monkeypatch, name):
    for module in ("compression.zstd", "zstandard", "lz4.frame"):
        monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(
        BagError, match=r"pip install 'uros\[compression\]', or pip install (zstandard|lz4) "
    ):
        BagWriter(tmp_path / "bag", compression=name)
    assert not (tmp_path / "bag").exists()
    BagWriter(tmp_path / "bag").close()


def test_the_extra_compiles_no_zstandard():
    """It has wheels on these for glibc and musl."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    lines = project["optional-dependencies"]["compression"]
    needs = {Requirement(line).name: Requirement(line) for line in lines}
    assert set(needs) == {"zstandard", "lz4"}
    found = set()
    for system, machine, python, implementation in (
        ("linux", "x86_64", "3.10", "CPython"),
        ("linux", "aarch64", "3.13", "CPython"),
        ("linux", "armv7l", "3.11", "CPython"),
        ("linux", "riscv64", "3.13", "CPython"),
        ("linux", "x86_64", "3.14", "CPython"),
        ("linux", "x86_64", "3.11", "PyPy"),
        ("darwin", "arm64", "3.12", "CPython"),
        ("win32", "AMD64", "3.12", "CPython"),
        ("freebsd14", "x86_64", "3.11", "CPython"),
    ):
        environment = {
            "sys_platform": system, "platform_machine": machine, "python_version": python,
            "platform_python_implementation": implementation,
        }  # fmt: skip
        if needs["zstandard"].marker.evaluate(environment):
            found.add((system, machine))
    assert found == {
        ("linux", "x86_64"), ("linux", "aarch64"), ("darwin", "arm64"), ("win32", "AMD64"),
    }  # fmt: skip
