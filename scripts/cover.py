"""Measures the coverage of a package of ``src/uros`` by its own tests: ``make coverage``.

    python scripts/cover.py [ROOM]...

It counts lines and branches together, of each package by its own folder of tests only. It fails
where a package is below MARK, and prints the lines and branches that are not covered.
"""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
MARK = 95
# The limit for one test: coverage makes it several times slower.
SECONDS = 300
# A package and its folder of tests.
ROOMS = {"wire": "tests/unit/wire", "agent": "tests/unit/agent"}


def measure(room: str) -> bool:
    """Whether the tests of a package run and cover enough of it."""
    data = ROOT / "build" / f"coverage-{room}"
    data.parent.mkdir(exist_ok=True)
    environment = dict(os.environ, COVERAGE_FILE=str(data), PYTHONPATH=str(ROOT / "src"))
    coverage = [sys.executable, "-m", "coverage"]
    print(f"\n=== src/uros/{room} by {ROOMS[room]} ===", flush=True)
    tests = [
        *coverage, "run", f"--source={ROOT / 'src' / 'uros' / room}",
        "-m", "pytest", "-q", "-p", "no:cacheprovider", f"--timeout={SECONDS}", "--tb=line",
        ROOMS[room],
    ]  # fmt: skip
    status = subprocess.run(tests, cwd=ROOT, env=environment).returncode
    if status == 1:
        print("coverage: tests that fail here and pass in `make test` are about time: what is"
              " measured is slow")  # fmt: skip
    elif status:
        print(f"coverage: the tests of {room} did not run")
        return False
    report = [*coverage, "report", "--show-missing", "--skip-covered", f"--fail-under={MARK}"]
    enough = subprocess.run(report, cwd=ROOT, env=environment).returncode == 0
    print(f"coverage: {room} is {'not below' if enough else 'below'} {MARK} %")
    return enough


def main() -> int:
    chosen = sys.argv[1:] or list(ROOMS)
    unknown = [room for room in chosen if room not in ROOMS]
    if unknown:
        sys.exit(f"usage: cover.py [{' | '.join(ROOMS)}]...: there is no {unknown[0]}")
    return 0 if all([measure(room) for room in chosen]) else 1


if __name__ == "__main__":
    sys.exit(main())
