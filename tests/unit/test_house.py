"""The structure of the project: imports between packages, where modules are, complete indexes.

docs/design has the reasons. Each rule is one test, which lists everything that breaks it. In the
names here, a *room* is a package or module directly in src/uros.
"""

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
from support import cyclone_tests
from support.long_tests import LONG
from support.paths import ROOT

from uros.middleware.cyclone_package import has_wheel

SOURCE = ROOT / "src" / "uros"

# What each room may import besides itself. A name that is no folder is a single module.
ALLOWED = {
    "wire": {"ticks"},
    "ticks": set(),
    "names": set(),
    "moved": set(),
    "printable": set(),
    "http_server": set(),
    "token_bucket": set(),
    "addresses": set(),
    "poller": set(),
    "file_lock": set(),
    "similar": set(),
    "drivers": set(),
    "control": set(),
    "qos": {"wire"},
    "interfaces": {"wire", "similar"},
    "transport": {"wire", "ticks", "agent"},
    "client": {"wire", "interfaces", "qos", "ticks"},
    "middleware": {"interfaces", "qos", "names", "token_bucket", "addresses", "poller"},
    "agent": {
        "wire", "ticks", "transport", "middleware", "qos", "names", "printable", "http_server",
        "token_bucket", "addresses", "poller", "file_lock",
    },
    "host": {"client", "middleware", "interfaces", "qos", "names", "printable"},
    "bag": {"interfaces", "qos", "names", "printable", "file_lock"},
    "dashboard": {"drivers", "http_server"},
    "boards": {
        "wire", "transport", "client", "control", "drivers", "middleware", "interfaces", "agent",
        "host", "dashboard", "qos", "ticks", "names", "printable", "http_server", "moved",
        "token_bucket", "addresses", "poller", "file_lock", "bag", "similar",
    },
    "tools": {
        "wire", "transport", "client", "control", "drivers", "middleware", "interfaces", "agent",
        "host", "boards", "dashboard", "qos", "ticks", "names", "printable", "http_server", "moved",
        "token_bucket", "addresses", "poller", "file_lock", "bag", "similar",
    },
}  # fmt: skip
# Packages within a room: what they must not import, and why.
INNER_WALLS = {
    "uros.agent.transports": (
        ("uros.agent",),
        "a transport knows its Host, and of the agent only clock and log",
    ),
    "uros.agent.session": (
        ("uros.agent.objects", "uros.agent.persistence", "uros.agent.observability"),
        "a session is streams and submessages: what is in them is for objects",
    ),
    "uros.agent.policy": (
        ("uros.agent.persistence", "uros.agent.observability"),
        "policy decides; others store and show",
    ),
    "uros.agent.objects": (
        ("uros.agent.persistence", "uros.agent.observability"),
        "objects do not know that they are stored or shown",
    ),
    "uros.boards.builder": (
        ("uros.boards.deploy", "uros.boards.virtual"), "the builder writes files for any board"
    ),
    "uros.boards.deploy": (("uros.boards.virtual",), "deploy is for real boards"),
    "uros.boards.virtual": (("uros.boards.deploy",), "virtual boards are not deployed to"),
}  # fmt: skip
# Folders that may have these modules alone: others belong into one of the packages there.
FULL = {
    "": {
        "__main__",
        "addresses",
        "file_lock",
        "http_server",
        "moved",
        "names",
        "poller",
        "printable",
        "qos",
        "similar",
        "ticks",
        "token_bucket",
    },
    "agent": {
        "agent",
        "clock",
        "context",
        "log",
        "malloc_trim",
        "server",
        "watchdog",
    },
    "boards": set(),
    "boards/virtual": set(),
    "tools": {
        "cli",
        "common",
        "demo",
        "empty",
        "ending",
        "errors",
        "fleet",
        "graph_types",
        "listing",
        "pages",
        "parser",
        "progress",
        "sim_time",
        "type_lookup",
        "waiting",
    },
}
# Tests that pytest does not collect by their name, and the test of the same folder that runs them.
RUN_BY_A_TEST = {"tests/interop/rclpy_middleware.py": "tests/interop/test_ros2_middleware.py"}
# Small modules that every package of the agent may import.
EVERYBODYS = {"uros.agent.clock", "uros.agent.log"}
# The modules of the agent that may use a module of the operating system. All others get the time
# from the agent's clock, and files and sockets from one of these, which a simulation can replace.
SYSTEM = {
    "time": ("clock", "observability.prometheus"),  # the latter sleeps, in a thread of its own
    "random": (),
    "secrets": (),
    "uuid": (),
    "socket": ("transports", "observability.prometheus", "observability.status_socket"),
    "os": (
        "log", "observability.audit", "observability.capture", "observability.snapshot",
        "observability.status_socket", "persistence.journal", "transports", "watchdog",
    ),
}  # fmt: skip
# Names that no variable may have.
PRONOUNS = {"it", "its", "them", "those", "that"}
# Texts that may bind one: parsing all takes ten times as long.
BINDING = re.compile(
    rf"\b({'|'.join(sorted(PRONOUNS))})\b\s*([-+*/%&|^@<>]*=|[,:)\];]|in\b|$)", re.MULTILINE
)
PASSED_OVER = {"build", "dist", "venv", "node_modules", "CVS", "_darcs"}


@cache
def modules() -> dict[str, Path]:
    """Return all modules of uros, by their full names."""
    files = {}
    for path in SOURCE.rglob("*.py"):
        parts = ["uros", *path.relative_to(SOURCE).with_suffix("").parts]
        files[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return files


@cache
def imports() -> dict[str, frozenset[str]]:
    """Return the modules of uros that each module imports, at any place and for type checkers."""
    return {name: frozenset(_imports(name, path)) - {name} for name, path in modules().items()}


def _imports(name: str, path: Path) -> Iterator[str]:
    package = name.split(".") if path.name == "__init__.py" else name.split(".")[:-1]
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in modules())
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else []
            stem = ".".join([*base, *(node.module.split(".") if node.module else [])])
            for alias in node.names:
                full = f"{stem}.{alias.name}"
                if full in modules():
                    yield full
                elif stem in modules():
                    yield stem


def room(name: str) -> str:
    return name.split(".")[1] if "." in name else ""


def within(name: str, package: str) -> bool:
    return name == package or name.startswith(package + ".")


def test_every_room_is_known() -> None:
    rooms = {room(name) for name in modules()} - {"", "__main__"}
    assert rooms == set(ALLOWED), "a room of src/uros is not in ALLOWED, or ALLOWED has one more"


def test_imports_stay_within_the_walls() -> None:
    wrong = []
    for name, imported in imports().items():
        if room(name) not in ALLOWED:
            continue
        may = ALLOWED[room(name)] | {room(name), ""}
        bad = sorted(module for module in imported if room(module) not in may)
        wrong += [
            f"{name} imports {module}, {room(name)} may not import {room(module)}" for module in bad
        ]
    assert not wrong, "\n".join(wrong)


def test_imports_stay_within_the_inner_walls() -> None:
    wrong = []
    for package, (barred, why) in INNER_WALLS.items():
        for name, imported in imports().items():
            if within(name, package):
                wrong += [
                    f"{name} imports {module}: {why}"
                    for module in sorted(imported)
                    if not within(module, package)
                    and module not in EVERYBODYS
                    and any(within(module, bar) for bar in barred)
                ]
    assert not wrong, "\n".join(wrong)


def test_these_modules_of_the_agent_alone_use_the_operating_system() -> None:
    wrong = []
    for name, path in modules().items():
        if not within(name, "uros.agent"):
            continue
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom) and not node.level:
                names = [node.module or ""]
            for system in SYSTEM.keys() & names:
                if not any(within(name, f"uros.agent.{module}") for module in SYSTEM[system]):
                    instead = "Clock" if system == "time" else "what its context gives it"
                    wrong.append(f"{name} imports {system}: let it use {instead}, or see SYSTEM")
    assert not wrong, "\n".join(wrong)


def test_no_variable_is_a_pronoun() -> None:
    """A reader must see what a variable holds."""
    wrong = []
    folders = [one for one in ROOT.iterdir() if one.is_dir() and one.name[0] != "."]
    folders = [one for one in folders if one.name != "build"]  # which may hold a whole Debian
    for path in sorted(path for folder in folders for path in folder.rglob("*.py")):
        relative = path.relative_to(ROOT)
        text = path.read_text("utf-8")
        for node in ast.walk(ast.parse(text)) if BINDING.search(text) else ():
            bound = [node.arg] if isinstance(node, ast.arg) else []
            if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
                bound = [node.id]
            if PRONOUNS & set(bound):
                wrong.append(f"{relative}:{node.lineno}: name {bound[0]!r} by what it holds")
    assert not wrong, "\n".join(wrong)


def test_no_import_circle() -> None:
    """Imports for type checkers and imports in functions count as well."""
    circles = [" → ".join([*circle, circle[0]]) for circle in _circles()]
    assert not circles, "modules import each other in a circle:\n" + "\n".join(circles)


def _circles() -> list[list[str]]:
    """Return the strongly connected parts of the import graph with several modules (Tarjan)."""
    found: list[list[str]] = []
    number: dict[str, int] = {}
    lowest: dict[str, int] = {}
    stack: list[str] = []

    def visit(name: str) -> None:
        number[name] = lowest[name] = len(number)
        stack.append(name)
        for other in imports()[name]:
            if other not in number:
                visit(other)
                lowest[name] = min(lowest[name], lowest[other])
            elif other in stack:
                lowest[name] = min(lowest[name], number[other])
        if lowest[name] == number[name]:
            part = stack[stack.index(name) :]
            del stack[stack.index(name) :]
            if len(part) > 1:
                found.append(part)

    for name in imports():
        if name not in number:
            visit(name)
    return found


def test_a_module_stands_in_a_room() -> None:
    wrong = []
    for folder, modules_of_it in FULL.items():
        rooms = sorted(index.parent.name for index in (SOURCE / folder).glob("*/__init__.py"))
        for path in (SOURCE / folder).glob("*.py"):
            if path.stem != "__init__" and path.stem not in modules_of_it:
                wrong.append(
                    f"{path.relative_to(ROOT)}: put it into one of {', '.join(rooms)},"
                    " or add it to FULL if it stands for all of them"
                )
    assert not wrong, "\n".join(wrong)


def test_each_package_lists_its_modules() -> None:
    """The docstring of ``__init__`` lists all modules, so that a reader finds the right file."""
    wrong = []
    for index in sorted(SOURCE.rglob("__init__.py")):
        folder = index.parent
        if folder == SOURCE or "shims" in folder.parts:  # boards have what is in shims
            continue
        text = ast.get_docstring(ast.parse(index.read_text("utf-8"))) or ""
        named = set(re.findall(r"^``(\w+)``", text, re.M))
        files = {path.stem for path in folder.glob("*.py")} - {"__init__"}
        files |= {path.parent.name for path in folder.glob("*/__init__.py")}
        missing, surplus = sorted(files - named), sorted(named - files)
        if missing:
            wrong.append(f"{index.relative_to(ROOT)} does not list {', '.join(missing)}")
        if surplus:
            wrong.append(f"{index.relative_to(ROOT)} lists what is not there: {', '.join(surplus)}")
        for bar, rows in re.findall(r"^(=+)  =+\n(.*?)^=+  =+$", text, re.M | re.S):
            wrong += [
                f"{index.relative_to(ROOT)}: beside its column: {row}"
                for row in rows.splitlines()
                if row[len(bar) : len(bar) + 2] != "  " or row[len(bar) + 2] == " "
            ]
    assert not wrong, "\n".join(wrong)


def test_every_folder_of_modules_is_a_package() -> None:
    folders = {path.parent for path in SOURCE.rglob("*.py")}
    bare = sorted(
        str(folder.relative_to(ROOT))
        for folder in folders
        if not (folder / "__init__.py").is_file()
    )
    assert not bare, f"no __init__.py with an index in {', '.join(bare)}"


def test_no_folder_has_a_name_that_tools_pass_over() -> None:
    """pytest and ruff skip such folders without a message."""
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True)
    paths = listed.stdout.splitlines() or [
        str(path.relative_to(ROOT)) for path in SOURCE.rglob("*")
    ]
    wrong = {path for path in paths if PASSED_OVER & set(Path(path).parts[:-1])}
    assert not wrong, f"name the folder otherwise: {', '.join(sorted(wrong))}"


def test_the_long_tests_are_there() -> None:
    gone = sorted(path for path in LONG if not (ROOT / "tests" / "unit" / path).is_file())
    assert not gone, f"support/long_tests.py names what is not there: {', '.join(gone)}"


COLLECTED = """
import pytest
found = []
class Lister:
    @pytest.hookimpl(tryfirst=True)
    def pytest_pycollect_makemodule(self, module_path, parent):
        found.append(str(module_path))
        return Empty.from_parent(parent, path=module_path)
class Empty(pytest.File):
    def collect(self):
        return []
pytest.main(["--collect-only", "-qq", "-p", "no:cacheprovider", "tests"], plugins=[Lister()])
print("FOUND", *found, sep="\\n")
"""


def test_every_file_with_tests_is_collected() -> None:
    """A folder or a file name that pytest ignores would hide its tests."""
    done = subprocess.run(
        [sys.executable, "-c", COLLECTED], cwd=ROOT, capture_output=True, text=True
    )
    collected = {Path(line) for line in done.stdout.partition("FOUND\n")[2].splitlines()}
    on_disk = {
        path
        for path in (ROOT / "tests").rglob("*.py")
        if re.search(r"^(?:async )?def test_", path.read_text("utf-8"), re.M)
    }
    missed = {str(file.relative_to(ROOT)) for file in on_disk - collected}
    if not has_wheel():
        missed -= {f"tests/unit/{path}" for path in cyclone_tests.FILES}
    for path, test in RUN_BY_A_TEST.items():
        assert Path(path).name in (ROOT / test).read_text("utf-8")
        missed.remove(path)
    assert collected and not missed, f"pytest does not collect {', '.join(sorted(missed))}"


def test_importing_uros_and_its_help_load_nothing_heavy() -> None:
    program = (
        "import sys, uros\n"
        "from uros.tools import cli\n"
        "try: cli.main(['--help'])\n"
        "except SystemExit: pass\n"
        "heavy = {'cyclonedds', 'numpy', 'rosbags', 'asyncio', 'ctypes', 'yaml'}\n"
        "heavy &= set(sys.modules)\n"
        "print('HEAVY', sorted(heavy))\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.stdout.splitlines()[-1] == "HEAVY []", done.stderr


LATE = (
    "persistence.session_store", "persistence.restore", "persistence.journal",
    "observability.audit", "observability.capture", "observability.pcapng",
    "observability.prometheus", "observability.format", "observability.diagnostics",
    "observability.diagnostic_array", "observability.health",
)  # fmt: skip


@pytest.mark.parametrize("name", LATE)
def test_what_an_agent_loads_late_is_there(name: str) -> None:
    """Else the test below would hold for a name that no longer is."""
    assert f"uros.agent.{name}" in modules()


def test_an_agent_loads_what_its_options_ask_for_and_no_more() -> None:
    program = (
        "import sys\n"
        "from uros.tools import cli\n"
        "cli.main(['agent', 'udp4', '-p', '0', '-m', 'memory', '-v', '0', '--stop-at-eof'])\n"
        "more = {'ssl', 'prometheus_client', 'http.server', 'asyncio', 'numpy', 'yaml'}\n"
        f"more |= {{'uros.agent.' + name for name in {LATE!r}}}\n"
        "print('MORE', sorted(more & set(sys.modules)))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], stdin=subprocess.DEVNULL, capture_output=True, text=True
    )
    assert done.stdout.splitlines()[-1:] == ["MORE []"], done.stdout + done.stderr
