"""Fuzzes one part of uros, guided by code coverage.

    python fuzz/run.py TARGET [--seconds 600] [--jobs 1]     until the seconds are used up
    python fuzz/run.py TARGET --replay FILE...               play inputs in plain Python
    python fuzz/run.py TARGET --minimise                     keep the best inputs in the corpus
    python fuzz/run.py all [--seconds 600]                   one target after the other

A run can be interrupted at any time, and the next one continues: the seconds of all runs add up
in build/fuzz/TARGET/progress.json, and the inputs are kept beside it. ``--anew`` starts from the
beginning. A finding is saved with the command that reproduces it, and the exit status is 1.
"""

from __future__ import annotations

import argparse
import hashlib
import importlib
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
KEPT = ROOT / "fuzz" / "corpus"
BUILD = ROOT / "build" / "fuzz"
sys.path[:0] = [str(ROOT / "src"), str(ROOT / "fuzz"), str(ROOT / "tests")]

from targets import TARGETS  # noqa: E402  (fuzz/targets, found by the line above)

# An input that takes more time or memory is a finding.
INPUT_SECONDS = 20
MEMORY_MB = 2048
MAX_LENGTH = 8192
# The limits of the kept corpus: of one input, and of all inputs of a target.
KEPT_INPUT = 4096
KEPT_BYTES = 34_000
HASH = 40  # the length of the engine's file names
_PRINT = 10.0  # seconds between printed lines
_SAVE = 1.0  # seconds between writes of a worker's count


# --- the process that fuzzes ----------------------------------------------------------


class Count:
    """Executions and seconds of one process, in a file that its parent reads."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._parent = os.getppid()
        self._executions = 0
        self._began = self._saved = time.monotonic()

    def one(self) -> None:
        self._executions += 1
        if self._executions & 15 == 0:
            now = time.monotonic()
            if now - self._saved >= _SAVE:
                self._saved = now
                self.save()
                if os.getppid() != self._parent:
                    os._exit(0)  # the parent, which stops this process, has ended

    def save(self) -> None:
        seconds = time.monotonic() - self._began
        write(self._path, {"executions": self._executions, "seconds": round(seconds, 2)})


def work(target: str, job: int, arguments: list[str]) -> None:
    """Fuzz, in a process of its own; the engine ends the process."""
    import atheris

    with atheris.instrument_imports(include=["uros"]):
        module = importlib.import_module(f"targets.{target}")
    mutate = getattr(module, "mutate", None)
    count: Count | None = None

    def one_input(data: bytes) -> None:
        nonlocal count
        if count is None:
            count = Count(BUILD / target / f"job-{job}.json")
        module.one_input(data)
        count.one()

    def mutated(data: bytes, most: int, seed: int) -> bytes:
        chance = random.Random(seed)

        def by_engine(part: bytes) -> bytes:
            return atheris.Mutate(part, len(part) + 64)

        if chance.random() < 0.1:
            return atheris.Mutate(data, most)
        return mutate(data, chance, by_engine)[:most]

    options = {} if mutate is None else {"custom_mutator": mutated}
    atheris.Setup([sys.argv[0], *arguments], one_input, **options)
    atheris.Fuzz()


# --- the process that the user started ---------------------------------------------------


def write(path: Path, values: dict) -> None:
    """Write a file atomically."""
    fresh = path.with_suffix(f".{os.getpid()}.new")
    fresh.write_text(json.dumps(values))
    fresh.replace(path)


def read(path: Path) -> dict:
    try:
        return json.loads(path.read_text())
    except (OSError, ValueError):
        return {"executions": 0, "seconds": 0.0}


def total(before: dict, folder: Path) -> dict:
    """The progress of all runs; parallel jobs count their seconds once."""
    jobs = [read(path) for path in folder.glob("job-*.json")]
    return {
        "executions": before["executions"] + sum(job["executions"] for job in jobs),
        "seconds": round(before["seconds"] + max((job["seconds"] for job in jobs), default=0.0), 2),
    }


def settle(folder: Path) -> dict:
    """Add the counts of an interrupted run to the total; the total."""
    progress = total(read(folder / "progress.json"), folder)
    write(folder / "progress.json", progress)
    for path in folder.glob("job-*.json"):
        path.unlink()
    return progress


def check_engine() -> None:
    done = subprocess.run([sys.executable, "-c", "import atheris"], capture_output=True)
    if done.returncode:
        sys.exit(
            "fuzz: the fuzzing engine is not installed: it needs Linux and Python 3.11 or newer,"
            " then: python -m pip install -e '.[fuzz]'"
            " (kept inputs are played without it: --replay)"
        )


def findings(folder: Path) -> list[Path]:
    return sorted(
        path for kind in ("crash", "timeout", "oom", "leak") for path in folder.glob(f"{kind}-*")
    )


def seed(target: str, folder: Path) -> None:
    """Write the valid inputs, in addition to the kept ones."""
    from targets import datagrams

    folder.mkdir(parents=True, exist_ok=True)
    if target in TARGETS and datagrams.CAPTURES.is_dir():
        for name, data in importlib.import_module(f"targets.{target}").seeds():
            (folder / name).write_bytes(data)


def fuzz(target: str, seconds: float, jobs: int) -> int:
    """Fuzz until ``seconds`` are used up, or until the first finding."""
    check_engine()
    folder = BUILD / target
    corpus = folder / "corpus"
    corpus.mkdir(parents=True, exist_ok=True)
    before = settle(folder)
    left = seconds - before["seconds"]
    if findings(folder):
        return report(target, folder)
    if left <= 0:
        print(f"fuzz {target}: full: {line(before)} (--anew begins anew)", flush=True)
        return 0
    seed(target, folder / "seeds")
    kept = KEPT / target
    kept.mkdir(parents=True, exist_ok=True)
    workers = []
    for job in range(jobs):
        arguments = [
            f"-artifact_prefix={folder}/", f"-max_total_time={int(left) + 1}",
            f"-timeout={INPUT_SECONDS}", f"-rss_limit_mb={MEMORY_MB}", f"-max_len={MAX_LENGTH}",
            "-print_final_stats=1", "-reload=1", str(corpus), str(kept), str(folder / "seeds"),
        ]  # fmt: skip
        log = (folder / f"job-{job}.log").open("wb")
        command = [sys.executable, __file__, target, "--work", str(job), *arguments]
        # A session of its own: Ctrl-C goes to this process only, which ends the workers.
        workers.append(subprocess.Popen(command, stdout=log, stderr=log, start_new_session=True))
        log.close()

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    signal.signal(signal.SIGTERM, interrupt)
    status = 0
    try:
        printed = time.monotonic()
        while any(worker.poll() is None for worker in workers):
            time.sleep(0.2)
            if any(worker.poll() for worker in workers):
                break  # a worker has a finding
            progress = total(before, folder)
            if progress["seconds"] >= seconds:
                break
            if time.monotonic() - printed >= _PRINT:
                printed = time.monotonic()
                print(f"fuzz {target}: {line(progress)} of {seconds:g} s", flush=True)
    except KeyboardInterrupt:
        status = 130
    for worker in workers:
        if worker.poll() is None:
            worker.send_signal(signal.SIGKILL)
        worker.wait()
    progress = settle(folder)
    print(f"fuzz {target}: {line(progress)} of {seconds:g} s", flush=True)
    if findings(folder):
        return report(target, folder)
    if any(worker.returncode not in (0, -signal.SIGKILL) for worker in workers):
        print((folder / "job-0.log").read_text(errors="replace")[-3000:])
        print(f"fuzz {target}: the engine failed, see {folder}/job-*.log")
        return 1
    return status


def line(progress: dict) -> str:
    return f"{progress['executions']} executions in {progress['seconds']:.0f} s"


def report(target: str, folder: Path) -> int:
    for log in sorted(folder.glob("job-*.log")):
        text = log.read_text(errors="replace")
        at = text.find("=== Uncaught Python exception")
        if at >= 0:
            print(text[at : at + 4000])
    for path in findings(folder):
        print(f"fuzz {target}: FOUND {path}")
        print(f"  play it again: {sys.executable} fuzz/run.py {target} --replay {path}")
    print(f"  when it is mended, keep it as a test: mv FILE fuzz/corpus/{target}/")
    return 1


def replay(target: str, files: list[Path]) -> int:
    """Play inputs; raises the errors of the target."""
    module = importlib.import_module(f"targets.{target}")
    for file in files:
        began = time.monotonic()
        module.one_input(file.read_bytes())
        print(f"fuzz {target}: {file}: nothing found, {time.monotonic() - began:.3f} s")
    return 0


def reached(one_input: Callable[[bytes], None], data: bytes) -> set[tuple[str, int, int]]:
    """The transitions between lines of uros that an input executes."""
    source = str(ROOT / "src" / "uros")
    steps: set[tuple[str, int, int]] = set()

    def called(frame: FrameType, event: str, _: object) -> Any:
        name = frame.f_code.co_filename
        if not name.startswith(source):
            return None
        last = 0

        def line(frame: FrameType, event: str, _: object) -> Any:
            nonlocal last
            if event == "line":
                steps.add((name, last, frame.f_lineno))
                last = frame.f_lineno
            return line

        return line

    sys.settrace(called)
    try:
        one_input(data)
    finally:
        sys.settrace(None)
    return steps


def minimise(target: str) -> int:
    """Keep the smallest inputs that together reach the same transitions, up to KEPT_BYTES.

    Inputs with names stay: valid inputs, and those of findings.
    """
    module = importlib.import_module(f"targets.{target}")
    folder = BUILD / target
    seed(target, folder / "seeds")
    kept = KEPT / target
    kept.mkdir(parents=True, exist_ok=True)
    names: dict[bytes, str] = {}
    for source in (kept, folder / "seeds"):
        for file in source.iterdir():
            if len(file.name) != HASH:
                names[file.read_bytes()] = file.name
            elif source == kept:
                names.setdefault(file.read_bytes(), "")
    for file in (folder / "corpus").glob("*"):
        names.setdefault(file.read_bytes(), "")
    known: set[tuple[str, int, int]] = set()
    room = KEPT_BYTES
    chosen = {}
    for data, name in sorted(names.items(), key=lambda entry: (not entry[1], len(entry[0]))):
        if len(data) > min(room, KEPT_INPUT):
            continue
        steps = reached(module.one_input, data)
        if name or not steps <= known:
            known |= steps
            room -= len(data)
            chosen[name or hashlib.sha1(data).hexdigest()] = data
    for file in kept.iterdir():
        file.unlink()
    for name, data in chosen.items():
        (kept / name).write_bytes(data)
    print(f"fuzz {target}: {len(chosen)} inputs kept, {KEPT_BYTES - room} bytes", flush=True)
    return 0


def main() -> int:
    parser = argparse.ArgumentParser(description="Fuzzes one part of uros.")
    parser.add_argument("target", choices=(*TARGETS, "all"), metavar="TARGET",
                        help=", ".join(TARGETS) + ", or all")  # fmt: skip
    parser.add_argument("--seconds", type=float, default=600.0, help="in all runs together (600)")
    parser.add_argument("--jobs", type=int, default=1, help="processes at the same time (1)")
    parser.add_argument("--anew", action="store_true", help="forget earlier runs and findings")
    parser.add_argument("--replay", nargs="+", type=Path, metavar="FILE", help="play inputs")
    parser.add_argument("--minimise", action="store_true", help="renew the kept corpus")
    if "--work" in sys.argv:
        at = sys.argv.index("--work")
        target, job, arguments = sys.argv[1], int(sys.argv[at + 1]), sys.argv[at + 2 :]
        sys.argv = sys.argv[:1]
        work(target, job, arguments)
        return 0
    options = parser.parse_args()
    chosen = TARGETS if options.target == "all" else (options.target,)
    status = 0
    for target in chosen:
        if options.anew:
            shutil.rmtree(BUILD / target, ignore_errors=True)
        if options.replay:
            status = replay(target, options.replay) or status
        elif options.minimise:
            status = minimise(target) or status
        else:
            status = fuzz(target, options.seconds, max(1, options.jobs)) or status
            if status == 130:
                break
    return status


if __name__ == "__main__":
    sys.exit(main())
