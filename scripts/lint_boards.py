"""Checks the programs in firmware/ and the drivers by mypy with the stubs of a MicroPython port.

    lint_boards.py             all of them
    lint_boards.py NAME ...    these folders of firmware/

uros/boards/virtual/models/catalog.py has the ports of a program. This script installs the stubs in
build/typings/PORT: in .venv they would replace the modules of CPython.
"""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
TYPINGS = ROOT / "build" / "typings"

# There are no stubs of renesas-ra, whose machine module descends from stm32's.
STUBS = {"esp32": "esp32", "rp2": "rp2", "stm32": "stm32", "renesas-ra": "stm32"}


def stubs(port: str) -> Path:
    """The folder of a port's stubs; installs them if missing or not the pinned version."""
    name = STUBS[port]
    folder = TYPINGS / name
    made = folder / "made"
    pins = (ROOT / "constraints.txt").read_text()
    if not made.exists() or made.read_text() != pins:
        print(f"lint: stubs of MicroPython's port {name} into {folder.relative_to(ROOT)}")
        subprocess.run(["rm", "-rf", folder], check=True)
        subprocess.run(
            [sys.executable, "-m", "pip", "install", "-q", "--disable-pip-version-check",
             "--no-deps", "-c", ROOT / "constraints.txt", "--target", folder,
             "micropython-stdlib-stubs", f"micropython-{name}-stubs"],
            check=True,
        )  # fmt: skip
        made.write_text(pins)
    return folder


def check(port: str, *targets: str) -> bool:
    """Whether mypy reports nothing.

    Each port has a configuration of its own, from which mypy takes the folder of stubs.
    """
    folder = stubs(port)
    text = (ROOT / "firmware" / "mypy.ini").read_text()
    config = TYPINGS / f"{STUBS[port]}.ini"
    config.write_text(text.replace("@STUBS@", str(folder)).replace("@ROOT@", str(ROOT)))
    print(f"lint: {' '.join(targets)} for {port}", flush=True)
    done = subprocess.run(
        [sys.executable, "-m", "mypy", "--config-file", config,
         "--cache-dir", ROOT / ".mypy_cache" / STUBS[port], *targets],
        cwd=ROOT,
    )  # fmt: skip
    return done.returncode == 0


def programs() -> dict[str, tuple[str, ...]]:
    """The ports of each folder of firmware/; exits with an error for a folder without a board."""
    from uros.boards.virtual.models.catalog import BOARDS

    ports = {board.firmware: board.ports for board in BOARDS.values()}
    programs_found = {}
    for main in sorted((ROOT / "firmware").glob("*/main.py")):
        name = main.parent.name
        if not ports.get(name):
            sys.exit(
                f"lint: firmware/{name} has no port: name it in"
                " src/uros/boards/virtual/models/catalog.py"
            )
        programs_found[name] = ports[name]
    return programs_found


def main(names: list[str]) -> int:
    sound = True
    for name, ports in programs().items():
        if not names or name in names:
            for port in ports:
                sound &= check(port, f"firmware/{name}/")
    if not names:
        # Drivers and control are for every port.
        for port in sorted({*STUBS.values()}):
            sound &= check(port, "-p", "uros.drivers", "-p", "uros.control")
    return 0 if sound else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
