"""An import of an old name raises an error with the new name, for each entry of the table."""

import importlib
import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest

import uros
from uros import moved

SOURCE = Path(uros.__file__).parent


def names_bound_in(module: str) -> set[str]:
    """Return the names that a module binds, without an import, for which tools may be missing."""
    import ast

    from uros.boards.builder.scopes import bound

    path = SOURCE.joinpath(*module.split(".")[1:])
    file = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
    return set(bound(ast.parse(file.read_text("utf-8")).body))


def is_module(name: str) -> bool:
    path = SOURCE.joinpath(*name.split(".")[1:])
    return path.with_suffix(".py").is_file() or (path / "__init__.py").is_file()


@pytest.mark.parametrize("old", moved.MODULES)
def test_a_moved_module_names_its_new_place_which_exists(old: str) -> None:
    new = moved.MODULES[old]
    assert is_module(new) and not is_module(old)
    with pytest.raises(ModuleNotFoundError) as caught:
        importlib.import_module(old)
    parents = [old.rsplit(".", up)[0] for up in range(1, old.count("."))]
    texts = {f"{module} is now {moved.MODULES.get(module)}" for module in (old, *parents)}
    assert str(caught.value) in texts


@pytest.mark.parametrize("old", moved.NAMES)
def test_a_moved_name_names_its_new_place_which_exists(old: str) -> None:
    module, _, name = old.rpartition(".")
    place, _, new_name = moved.NAMES[old].rpartition(".")
    assert is_module(module) and not is_module(old) and name not in names_bound_in(module)
    assert new_name in names_bound_in(place)
    with pytest.raises(ImportError) as caught:
        exec(f"from {module} import {name}", {})
    assert str(caught.value) == f"{old} is now {moved.NAMES[old]}"


@pytest.mark.parametrize(
    "statement",
    (
        "import uros.transport.stream",
        "from uros.transport.stream import StreamTransport",
        "from uros.transport import stream",
        "import uros.transport.stream as line",
    ),
)
def test_each_form_of_import_raises_the_new_name(statement: str) -> None:
    with pytest.raises(ModuleNotFoundError, match=r"uros\.transport\.stream is now") as caught:
        exec(statement, {})
    assert "uros.transport.serial" in str(caught.value)


def test_a_module_inside_of_a_moved_package_raises_the_new_name() -> None:
    with pytest.raises(ModuleNotFoundError, match="uros.boards.shims is now uros.boards.virtual"):
        importlib.import_module("uros.boards.shims.machine")
    assert moved.advice("uros.boards.shims.machine").startswith("uros.boards.shims is now")


def test_other_imports_are_unchanged() -> None:
    assert importlib.import_module("uros.transport.udp").UdpTransport
    assert moved.advice("uros.transport.udp.UdpTransport") == ""
    assert moved.advice("uros.transport.telepathy") == ""
    with pytest.raises(ModuleNotFoundError, match="No module named"):
        importlib.import_module("uros.transport.telepathy")
    with pytest.raises(ImportError, match="cannot import name"):
        exec("from uros.transport.udp import Telepathy", {})
    session = importlib.import_module("uros.agent.session")
    assert not hasattr(session, "nothing_of_the_kind")


def test_install_is_idempotent() -> None:
    moved.install()
    moved.install()
    assert sum(finder is moved._Finder for finder in sys.meta_path) == 1


def test_a_programs_traceback_has_the_new_name() -> None:
    program = "from uros.transport.udp import UdpServer\n"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == 1
    assert "uros.transport.udp.UdpServer is now uros.agent.transports.udp.UdpServer" in done.stderr


def test_importing_uros_loads_only_the_table() -> None:
    program = (
        "import sys; before = set(sys.modules); sys.path.insert(0, sys.argv[1]); import uros;"
        "print(sorted(set(sys.modules) - before))"
    )
    done = subprocess.run(
        [sys.executable, "-I", "-S", "-c", program, str(SOURCE.parent)],
        capture_output=True, text=True,
    )  # fmt: skip
    assert done.stdout.strip() == "['__future__', 'uros', 'uros.moved']", done.stderr
