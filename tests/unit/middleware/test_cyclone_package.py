"""Where PyPI has a wheel of cyclonedds, by pyproject.toml and by uros; and whether it is there."""

import itertools
import platform
import sys
from collections import namedtuple

import pytest
from packaging.requirements import Requirement
from support.paths import ROOT

from uros.middleware import cyclone_package

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

SYSTEMS = ("linux", "darwin", "win32", "android", "freebsd14")
MACHINES = ("x86_64", "AMD64", "aarch64", "arm64", "ARM64", "armv7l", "armv6l", "i686", "riscv64")
PYTHONS = ((3, 10), (3, 11), (3, 13), (3, 14))
IMPLEMENTATIONS = ("CPython", "PyPy")
Version = namedtuple("Version", "major minor micro releaselevel serial")


def requirement():
    """What pyproject.toml says of cyclonedds."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    (line,) = project["optional-dependencies"]["dds"]
    return Requirement(line)


def test_the_markers_of_the_dependency_say_the_same_as_has_wheel(monkeypatch):
    marker = requirement().marker
    found = set()
    for system, machine, python, implementation in itertools.product(
        SYSTEMS, MACHINES, PYTHONS, IMPLEMENTATIONS
    ):
        version = ".".join(map(str, python))
        with monkeypatch.context() as there:
            there.setattr(sys, "platform", system)
            there.setattr(sys, "version_info", Version(*python, 0, "final", 0))
            there.setattr(platform, "machine", lambda machine=machine: machine)
            there.setattr(platform, "libc_ver", lambda: ("glibc", "2.36"))
            there.setattr(
                platform,
                "python_implementation",
                lambda implementation=implementation: implementation,
            )
            has_wheel = cyclone_package.has_wheel()
        environment = {
            "sys_platform": system, "platform_machine": machine, "python_version": version,
            "platform_python_implementation": implementation,
        }  # fmt: skip
        assert marker.evaluate(environment) == has_wheel, environment
        if has_wheel:
            found.add((system, machine, implementation))
    assert found == {
        ("linux", "x86_64", "CPython"), ("darwin", "x86_64", "CPython"),
        ("darwin", "arm64", "CPython"), ("win32", "AMD64", "CPython"),
    }  # fmt: skip


@pytest.mark.parametrize("libc", [("", ""), ("musl", "1.2.5")])
def test_there_is_no_wheel_for_a_linux_without_glibc(monkeypatch, libc):
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setattr(platform, "libc_ver", lambda: libc)
    assert not cyclone_package.has_wheel()
    remedy = cyclone_package.remedy()
    assert " without glibc: use -m rtps" in remedy and "pip install" not in remedy


def test_the_remedy_names_the_version_of_the_dependency(monkeypatch):
    monkeypatch.setattr(cyclone_package, "has_wheel", lambda: True)
    wanted = requirement()
    assert f"'{wanted.name}{wanted.specifier}'" in cyclone_package.remedy()


def test_a_package_that_is_missing_and_one_that_does_not_load(monkeypatch):
    monkeypatch.setitem(sys.modules, "cyclonedds", None)
    assert cyclone_package.why_missing() == cyclone_package.NOT_INSTALLED
    monkeypatch.undo()
    import builtins

    load = builtins.__import__

    def fail(name, *rest):
        if name.startswith("cyclonedds"):
            raise ImportError("libddsc.so.11: cannot open shared object file")
        return load(name, *rest)

    monkeypatch.setattr(builtins, "__import__", fail)
    why = cyclone_package.why_missing()
    assert why.startswith("cyclonedds cannot be loaded (libddsc.so.11")
