"""Tests of the packages for mip: their content, and that the project's manifests are up to date."""

import hashlib
import json
from pathlib import Path

import pytest
from support.paths import ROOT

from uros.boards.builder.errors import BuildError
from uros.boards.deploy.mip import (
    CORE,
    parts,
    portable,
    project_manifests,
    write_index,
    write_manifest,
)


@pytest.mark.parametrize("name", ["package.json", "package-all.json"])
def test_the_projects_manifests_are_up_to_date(name: str) -> None:
    text = (ROOT / name).read_text("utf-8")
    assert text == project_manifests()[name], "run: python -m uros.boards.deploy.mip"
    for target, source in json.loads(text)["urls"]:
        assert source == "src/" + target and (ROOT / source).is_file()


def test_the_client_package_lacks_optional_modules() -> None:
    modules, types = parts()[CORE]
    assert {"uros.client", "uros.client.node", "uros.client.session", "uros.wire"} <= modules
    assert {"uros.transport.serial", "uros.interfaces.runtime"} <= modules
    assert not {
        "uros.client.parameters", "uros.client.actions", "uros.client.lifecycle", "uros.client.tf",
        "uros.transport.tls", "uros.drivers.sht3x",
    } & modules  # fmt: skip
    assert not types


def test_every_module_for_boards_is_in_some_package() -> None:
    packed = {name for modules, _ in parts().values() for name in modules}
    assert {name for name, module in portable().items() if not module.package} <= packed


@pytest.mark.slow
def test_no_two_modules_have_the_same_package() -> None:
    core = parts()[CORE][0]
    single = [
        name for name, module in portable().items() if name not in core and not module.package
    ]
    assert len(parts()) == len(single) + 1


def test_a_package_contains_the_imports_that_the_client_lacks() -> None:
    packages = parts()
    assert packages["uros-parameters"][0] >= {"uros.client.parameters", "uros.client.parameter"}
    assert packages["uros-tls"][0] == {"uros.transport.tls", "uros.transport.tcp"}
    for name, (modules, _) in packages.items():
        assert name == CORE or not modules & packages[CORE][0]


def read(root: Path, form: str, name: str) -> tuple[dict[str, bytes], list[list[str]]]:
    manifest = json.loads((root / "package" / form / name / "latest.json").read_text("utf-8"))
    files = {}
    for path, short in manifest["hashes"]:
        files[path] = (root / "file" / short[:2] / short).read_bytes()
        assert hashlib.sha256(files[path]).hexdigest().startswith(short)
    return files, manifest["deps"]


def test_an_index_has_modules_and_types_in_both_forms(tmp_path: Path) -> None:
    wanted = ["std_msgs/msg/Int32", "std_msgs/msg/Header"]
    steps: list[tuple[int, int]] = []
    names = write_index(
        tmp_path, interfaces=wanted, progress=lambda done, total: steps.append((done, total))
    )
    assert steps == [(at, 2 * len(names)) for at in range(2 * len(names))]
    assert {"uros", "uros-parameters", "std_msgs", *wanted} <= set(names)
    for form, suffix in (("py", ".py"), ("6", ".mpy")):
        files, deps = read(tmp_path, form, "uros")
        assert deps == [] and f"uros/client/node{suffix}" in files
        assert all(path.endswith(suffix) for path in files)
        files, deps = read(tmp_path, form, "uros-parameters")
        assert deps == [["uros", "latest"]] and f"uros/client/parameters{suffix}" in files
        files, deps = read(tmp_path, form, "std_msgs/msg/Header")
        assert deps == [] and f"builtin_interfaces/msg/_time{suffix}" in files
        assert f"std_msgs/msg/_int32{suffix}" not in files
        assert f"std_msgs/msg/_int32{suffix}" in read(tmp_path, form, "std_msgs")[0]
    text = read(tmp_path, "py", "uros")[0]["uros/client/node.py"].decode()
    assert '"""' not in text and "def create_publisher(self" in text


def test_an_unknown_form_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BuildError, match="no form 'exe'"):
        write_index(tmp_path, ["exe"], [])


def test_a_programs_manifest_names_its_files(tmp_path: Path) -> None:
    files = [tmp_path / "main.py", tmp_path / "lib" / "a.mpy"]
    manifest = json.loads(write_manifest(tmp_path, files).read_text("utf-8"))
    assert manifest["urls"] == [["lib/a.mpy", "lib/a.mpy"], ["main.py", "main.py"]]
