"""The wheel and the source distribution have the files that they must have, and no others."""

import re
import subprocess
import sys
import tarfile
import zipfile
from collections import Counter
from email.parser import Parser
from pathlib import PurePosixPath

import pytest
from support.paths import ROOT

BUILD = """
import sys
from hatchling.build import build_sdist, build_wheel
print((build_wheel if sys.argv[1] == "wheel" else build_sdist)(sys.argv[2]))
"""
# What of the project's folder the source distribution has, besides the build's own two files.
TOP = {
    ".ci", ".github", "bench", "deploy", "docs", "firmware", "fuzz", "scripts", "src", "tests",
    ".gitignore", "CHANGELOG.md", "CONTRIBUTING.md", "LICENSE", "Makefile", "README.md",
    "SECURITY.md", "constraints-jazzy.txt", "constraints-kilted.txt", "constraints.txt",
    "manifest.py", "mkdocs.yml", "package-all.json", "package.json", "pyproject.toml", "PKG-INFO",
}  # fmt: skip
# Suffixes of the files of the wheel below uros/.
SUFFIXES = {".action", ".css", ".html", ".ini", ".js", ".md", ".mjs", ".msg", ".py", ".pyi", ".srv",
            ".txt", ".typed"}  # fmt: skip
# Files without which a command fails, one of each kind.
NEEDED = [
    "uros/py.typed",
    "uros/interfaces/definitions/std_msgs/msg/String.msg",
    "uros/interfaces/hashes.txt",
    "uros/boards/builder/foreign_names.txt",
    "uros/boards/virtual/engine/micropython.mjs",
    "uros/boards/firmware/ra6m5_sensor_node/main.py",
    "uros/boards/firmware/README.md",
]
NEVER = re.compile(
    r"__pycache__|\.pyc$|\.venv|node_modules|/build/(arm64|micropython)|\.(pem|key|env|log|jsonl\.1)$"
)


def build(kind, folder):
    done = subprocess.run(
        [sys.executable, "-c", BUILD, kind, str(folder)],
        cwd=ROOT, capture_output=True, text=True, check=True,
    )  # fmt: skip
    return folder / done.stdout.split()[-1]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    return build("wheel", tmp_path_factory.mktemp("wheel"))


@pytest.fixture(scope="module")
def sdist(tmp_path_factory):
    return build("sdist", tmp_path_factory.mktemp("sdist"))


def sources(*folders):
    """Return the paths of a folder's files, from there, without what running them leaves."""
    return {
        path.relative_to(folder).as_posix()
        for folder in folders
        for path in folder.rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }


def test_the_wheel_is_the_package_and_the_examples(wheel):
    names = zipfile.ZipFile(wheel).namelist()
    package = {name.removeprefix("uros/") for name in names if name.startswith("uros/")}
    examples = {"boards/firmware/" + name for name in sources(ROOT / "firmware")}
    assert package == sources(ROOT / "src" / "uros") | examples
    assert not set(NEEDED) - set(names)
    assert {PurePosixPath(name).suffix for name in package} <= SUFFIXES
    rest = {name.partition("/")[0] for name in names if not name.startswith("uros/")}
    assert len(rest) == 1 and rest.pop().endswith(".dist-info")
    assert not [name for name in names if NEVER.search(name)]
    assert max(Counter(names).values()) == 1


def test_the_wheel_says_what_it_needs_and_starts(wheel):
    archive = zipfile.ZipFile(wheel)
    (folder,) = {name.partition("/")[0] for name in archive.namelist()} - {"uros"}
    metadata = Parser().parsestr(archive.read(f"{folder}/METADATA").decode())
    assert metadata["Requires-Python"] == ">=3.10"
    plain = [one for one in metadata.get_all("Requires-Dist") if "extra ==" not in one]
    assert sorted(re.split(r"[^\w.-]", one)[0] for one in plain) == ["pyyaml", "tomli"]
    assert folder + "/licenses/LICENSE" in archive.namelist()
    commands = archive.read(f"{folder}/entry_points.txt").decode()
    assert set(re.findall(r"^(\w+) = uros\.", commands, re.M)) == {
        "uros", "MicroXRCEAgent", "micro_ros_agent"
    }  # fmt: skip
    assert wheel.stat().st_size < 3_000_000


def test_the_source_distribution_has_what_the_tests_and_the_packages_need(sdist):
    with tarfile.open(sdist) as archive:
        members = [member for member in archive.getmembers() if member.isfile()]
    names = {member.name.partition("/")[2] for member in members}
    assert {name.partition("/")[0] for name in names} == TOP
    for folder in ("src", "firmware", "deploy", "scripts", "docs"):
        inside = {name.removeprefix(folder + "/") for name in names if name.startswith(folder)}
        assert inside == sources(ROOT / folder), folder
    assert not [name for name in names if NEVER.search(name)]
    assert {member.uid for member in members} == {0} and sdist.stat().st_size < 6_000_000


def test_a_build_is_reproducible(wheel, sdist, tmp_path):
    assert build("wheel", tmp_path).read_bytes() == wheel.read_bytes()
    assert build("sdist", tmp_path).read_bytes() == sdist.read_bytes()
