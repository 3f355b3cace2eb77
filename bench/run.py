"""All benchmarks, one after the other: ``make bench``, ``make bench ARGS=--quick``."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
BENCHMARKS = ("middleware.py", "agent.py", "fleet.py", "services.py", "first_calls.py", "drive.py")


def main() -> int:
    failed = 0
    for name in BENCHMARKS:
        print(f"bench/{name}", flush=True)
        failed |= subprocess.run([sys.executable, HERE / name, *sys.argv[1:]]).returncode
    return failed


if __name__ == "__main__":
    raise SystemExit(main())
