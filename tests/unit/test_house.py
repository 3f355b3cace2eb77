"""Which room may import which: the table of docs/design/README.md."""

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

SOURCE = Path(__file__).resolve().parents[2] / "src" / "uros"

# What each room may import besides itself. "qos", "ticks", "names" and "printable" are single
# modules.
ALLOWED = {
    "wire": {"ticks"},
    "ticks": set(),
    "names": set(),
    "moved": set(),
    "printable": set(),
    "http_server": set(),
    "drivers": set(),
    "control": set(),
    "qos": {"wire"},
    "interfaces": {"wire"},
    "transport": {"wire", "ticks", "agent"},
    "client": {"wire", "interfaces", "qos", "ticks"},
    "middleware": {"interfaces", "qos", "names"},
    "agent": {
        "wire", "ticks", "transport", "middleware", "qos", "names", "printable", "http_server",
    },
    "host": {"client", "middleware", "interfaces", "qos", "names", "printable"},
    "dashboard": {"drivers", "http_server"},
    "boards": {
        "wire", "transport", "client", "control", "drivers", "middleware", "interfaces", "agent",
        "host", "dashboard", "qos", "ticks", "names", "printable", "http_server", "moved",
    },
    "tools": {
        "wire", "transport", "client", "control", "drivers", "middleware", "interfaces", "agent",
        "host", "boards", "dashboard", "qos", "ticks", "names", "printable", "http_server", "moved",
    },
}  # fmt: skip


INDEXED = (
    "agent", "client", "control", "drivers", "host", "interfaces", "middleware", "tools",
    "transport", "wire",
)  # fmt: skip


def rooms_imported(path: Path) -> set[str]:
    """The rooms of uros that a module imports, anywhere in it."""
    package = ("uros", *path.relative_to(SOURCE).parent.parts)
    found = set()
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else ()
            stem = ".".join((*base, node.module)) if node.module else ".".join(base)
            names = [stem] if stem != "uros" else [f"uros.{alias.name}" for alias in node.names]
        found |= {name.split(".")[1] for name in names if name.startswith("uros.")}
    return found - {"__version__"}


def modules() -> list[Path]:
    return sorted(path for path in SOURCE.rglob("*.py") if path.parent != SOURCE) + [
        SOURCE / "qos.py",
        SOURCE / "ticks.py",
        SOURCE / "names.py",
        SOURCE / "moved.py",
        SOURCE / "printable.py",
        SOURCE / "http_server.py",
    ]


@pytest.mark.parametrize("path", modules(), ids=lambda path: str(path.relative_to(SOURCE)))
def test_imports_stay_within_the_walls(path: Path) -> None:
    room = path.relative_to(SOURCE).parts[0].removesuffix(".py")
    strangers = rooms_imported(path) - ALLOWED[room] - {room}
    assert not strangers, f"{room} may not import {', '.join(sorted(strangers))}"


def test_transports_of_the_agent_import_its_log_clock_and_token_buckets_only() -> None:
    """So they need neither sessions nor policy."""
    wrong = []
    for path in sorted((SOURCE / "agent" / "transports").glob("*.py")):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.level == 2:
                names = [node.module] if node.module else [alias.name for alias in node.names]
                wrong += [
                    f"{path.name}: {name}"
                    for name in names
                    if name not in ("log", "clock", "token_bucket")
                ]
    assert not wrong, "agent/transports imports: " + ", ".join(wrong)


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


def test_an_agent_loads_what_its_options_ask_for_and_no_more() -> None:
    program = (
        "import sys\n"
        "from uros.tools import cli\n"
        "cli.main(['agent', 'udp4', '-p', '0', '-m', 'memory', '-v', '0', '--stop-at-eof'])\n"
        "parts = ('keeper', 'restoring', 'state', 'capture', 'pcapng', 'metrics', 'describe')\n"
        "more = {'ssl', 'prometheus_client', 'http.server', 'asyncio', 'ctypes', 'numpy', 'yaml'}\n"
        "more |= {'uros.agent.' + it for it in parts}\n"
        "print('MORE', sorted(more & set(sys.modules)))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], stdin=subprocess.DEVNULL, capture_output=True, text=True
    )
    assert done.stdout.splitlines()[-1:] == ["MORE []"], done.stdout + done.stderr


@pytest.mark.parametrize("path", modules(), ids=lambda path: str(path.relative_to(SOURCE)))
def test_no_module_is_a_warehouse(path: Path) -> None:
    assert len(path.read_text("utf-8").splitlines()) <= 700


def test_each_package_lists_its_modules() -> None:
    """In the docstring of its ``__init__``: a reader finds the file for a subject there."""
    wrong = []
    for index in SOURCE.rglob("__init__.py"):
        folder = index.parent
        if folder == SOURCE or folder.relative_to(SOURCE).parts[0] not in INDEXED:
            continue
        told = ast.get_docstring(ast.parse(index.read_text("utf-8"))) or ""
        named = set(re.findall(r"^``(\w+)``", told, re.M))
        there = {path.stem for path in folder.glob("*.py")} - {"__init__"}
        there |= {path.parent.name for path in folder.glob("*/__init__.py")}
        if named != there:
            wrong.append(f"{folder.relative_to(SOURCE)}: {sorted(named ^ there)}")
    assert not wrong, "an __init__.py lists too little or too much:\n" + "\n".join(wrong)
