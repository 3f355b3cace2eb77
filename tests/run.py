"""Runs the test groups, one pytest process each, and prints a line for each group at the end.

    tests/run.py [--full] [--group NAME]... [--middleware NAME] [--ros DISTRO]

The exit status is 0 only if every group ran at least one test and none failed. A skipped test
counts as failed unless its reason begins with 'not on this platform:'. The groups interop and
boards need real ROS 2: where it cannot be installed they are reported as not run, which is a
failure in CI (CI=true).
"""

import argparse
import ast
import codecs
import os
import selectors
import subprocess
import sys
import tempfile
import threading
import time
import xml.etree.ElementTree as ET
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TextIO

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "scripts"))

import env  # noqa: E402  (scripts/env.py, found by the line above)

GROUPS = ("unit", "contract", "replay", "interop", "boards", "mpy", "soak", "docs")
# So many groups run at a time, the longest ones first, which keeps two cores busy. The output of
# the first is shown at once, that of the others at the end.
PARALLEL = 3
LONGEST_FIRST = ("unit", "interop", "mpy", "boards", "contract", "replay", "docs", "soak")
# The longest groups have two processes, with whole files each.
TWO: tuple[str, ...] = ("-n", "2", "--dist", "loadfile")
WORKERS = {"unit": TWO, "interop": TWO}
PREPARE = {
    "unit": (env.micropython,),
    "interop": (env.micropython, env.ddsperf),
    "boards": (env.micropython,),
    "mpy": (env.micropython,),
    "docs": (env.micropython,),
}
PREPARING = threading.Lock()  # several groups need the same environment
NEED_ROS = ("interop", "boards")
# Their agents and host nodes run on the middleware that --middleware chooses.
ON_MIDDLEWARE = ("replay", "interop", "boards")
MIDDLEWARES = ("dds", "rtps")
# The rclpy of these is that of the distro that --ros chooses.
ON_ROS = ("interop",)
EXCUSE = "not on this platform:"

# pytest-timeout ends a test that hangs, but not one that hangs in C with the interpreter's lock.
# A group is stopped after this many seconds without output of pytest; its whole duration, which
# depends on the machine, has no limit.
SILENCE_SECONDS = 900


@dataclass
class Result:
    """The result of a group. `trouble` is a failure of the group as a whole."""

    group: str
    passed: int = 0
    failed: int = 0
    skipped: int = 0
    seconds: float = 0.0
    trouble: str = ""
    not_run: str = ""
    bad_skips: list[str] = field(default_factory=list)

    def line(self) -> str:
        if self.not_run:
            return f"{self.group}: NOT RUN ({self.not_run})"
        counts = f"{self.passed} passed, {self.failed} failed, {self.skipped} skipped"
        trouble = f"; {self.trouble}" if self.trouble else ""
        return f"{self.group}: {counts}, {self.seconds:.1f} s{trouble}"


def skip_reason(skipped: ET.Element) -> str:
    """The reason of a skip; that of a whole module is in the text, as a printed tuple."""
    message = skipped.get("message", "")
    if message == "collection skipped":
        _file, _line, message = ast.literal_eval(skipped.text or "")
    return message.removeprefix("Skipped: ")


def count(result: Result, report: Path) -> None:
    """Add the tests of a junit report of pytest to a result."""
    try:
        cases = list(ET.parse(report).iter("testcase"))
    except (OSError, ET.ParseError):
        result.trouble = "pytest ended without a report"
        return
    for case in cases:
        skipped = case.find("skipped")
        if case.find("failure") is not None or case.find("error") is not None:
            result.failed += 1
        elif skipped is None:
            result.passed += 1
        elif skip_reason(skipped).startswith(EXCUSE):
            result.skipped += 1
        else:
            result.failed += 1
            name = "::".join(filter(None, (case.get("classname"), case.get("name"))))
            result.bad_skips.append(f"{name}: {skip_reason(skipped)}")
    if not cases:
        result.trouble = "no tests"


def run_watched(command: list[str], output: TextIO | None) -> int | None:
    """The exit status of a command; None if it was stopped after SILENCE_SECONDS."""
    screen = output or sys.stdout
    if screen.isatty():
        command = [*command, "--color=yes"]
    process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    assert process.stdout
    decoder = codecs.getincrementaldecoder("utf-8")("replace")
    last_output = time.monotonic()
    with process.stdout, selectors.DefaultSelector() as selector:
        selector.register(process.stdout, selectors.EVENT_READ)
        while True:
            if selector.select(1.0):
                data = os.read(process.stdout.fileno(), 65536)
                screen.write(decoder.decode(data))
                screen.flush()
                if not data:
                    break
                last_output = time.monotonic()
            elif process.poll() is not None:
                break  # a process that a test left behind keeps the pipe open
            elif time.monotonic() - last_output > SILENCE_SECONDS:
                process.kill()
                process.wait()
                return None
    return process.wait()


def run_group(group: str, full: bool, distro: str, output: TextIO | None = None) -> Result:
    """Run the tests of a group with a ROS 2 distro; their output goes to ``output``."""
    result = Result(group)
    started = time.monotonic()
    print(f"\n=== {group} ===", file=output, flush=True)
    if not (ROOT / "tests" / group).is_dir():
        result.trouble = f"no tests: there is no folder tests/{group}"
        return result
    try:
        with PREPARING:
            if group in NEED_ROS:
                env.ros(distro)
            for prepare in PREPARE.get(group, ()):
                prepare()
    except env.Unavailable as error:
        print(f"{group}: {error}", flush=True)
        result.not_run = str(error)
        return result
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.xml"
        command = [sys.executable, "-m", "pytest", "-q", f"tests/{group}", f"--junitxml={report}"]
        command += WORKERS.get(group, ())
        command += ["--hypothesis-profile=deep"] if full else ["-m", "not slow"]
        status = run_watched(command, output)
        if status is None:
            result.trouble = f"stopped: no test ended in {SILENCE_SECONDS} s"
        else:
            count(result, report)
    # pytest can also fail with no failed test: interrupted, an internal error, a crash at exit.
    if status != 0 and not result.failed and not result.trouble:
        result.trouble = f"pytest exited with status {status}"
    result.seconds = time.monotonic() - started
    return result


def main() -> int:
    parser = argparse.ArgumentParser(description="Runs uros's tests, group by group.")
    parser.add_argument("--full", action="store_true", help="also the tests marked slow")
    parser.add_argument(
        "--group", action="append", choices=GROUPS, metavar="NAME",
        help=f"only this group; can be given again ({', '.join(GROUPS)})",
    )  # fmt: skip
    parser.add_argument(
        "--middleware", choices=MIDDLEWARES, metavar="NAME",
        help=f"the middleware of agents and host nodes ({' or '.join(MIDDLEWARES)}); without"
        f" --group only of {', '.join(ON_MIDDLEWARE)}",
    )  # fmt: skip
    parser.add_argument(
        "--ros", choices=tuple(env.ROS_VENVS), metavar="DISTRO",
        help=f"the ROS 2 on the other side ({' or '.join(env.ROS_VENVS)}); without --group only of"
        f" {', '.join(ON_ROS)}",
    )  # fmt: skip
    options = parser.parse_args()
    some = ON_ROS if options.ros else ON_MIDDLEWARE if options.middleware else GROUPS
    groups = options.group or some
    chosen = [group for group in GROUPS if group in groups]
    if options.middleware:
        os.environ["UROS_TEST_MIDDLEWARE"] = options.middleware  # see support/middleware.py
    distro = options.ros or next(iter(env.ROS_VENVS))
    if options.ros:
        os.environ["UROS_TEST_ROS_PYTHON"] = str(env.ROS_VENVS[options.ros] / "bin" / "python")
    # Without compiled modules each process compiles uros again, and pytest rewrites each test:
    # to collect tests/unit then takes 36 s of processor time instead of 10.
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    started = time.monotonic()
    in_ci = os.environ.get("CI", "").lower() not in ("", "0", "false")

    waiting = [group for group in LONGEST_FIRST if group in chosen]
    by_group: dict[str, Result] = {}

    def run_one(group: str, output: TextIO | None) -> None:
        by_group[group] = run_group(group, options.full, distro, output)
        if output:
            print(f"\n--- {by_group[group].line()}", flush=True)

    if "docs" in chosen and options.full:
        with suppress(env.Unavailable):  # tests/docs/test_site.py reports it
            env.docs()  # before the groups: pip must not change .venv while tests run

    with ExitStack() as stack:
        outputs = [
            stack.enter_context(tempfile.TemporaryFile("w+", encoding="utf-8")) for _ in waiting[1:]
        ]
        with ThreadPoolExecutor(PARALLEL) as pool:
            list(pool.map(run_one, waiting, [None, *outputs]))
        for output in outputs:
            output.seek(0)
            print(output.read())
    results = [by_group[group] for group in chosen]

    print()
    for result in results:
        for skip in result.bad_skips:
            print(f"skipped without an excuse: {skip}")
    for result in results:
        print(result.line())
    passed = sum(result.passed for result in results)
    skipped = sum(result.skipped for result in results)
    failed = sum(result.failed for result in results)
    failed += sum(1 for result in results if result.trouble)
    # Only the groups of NEED_ROS may be impossible on a machine.
    failed += sum(1 for r in results if r.not_run and (in_ci or r.group not in NEED_ROS))
    counts = f"{passed} passed, {failed} failed" + (f", {skipped} skipped" if skipped else "")
    where = "".join(f"{name}: " for name in (options.ros, options.middleware) if name)
    print(f"{where}{counts}, {time.monotonic() - started:.0f} s")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
