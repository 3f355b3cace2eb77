"""Runs ``main.py`` on MicroPython as a board does, for ``engine/micropython.mjs``."""

import gc
import io
import sys

import _board  # type: ignore[import-not-found]

_step = None
_measured = False
_peak = 0


def run(sliced: bool, measured: bool) -> bool:
    """Run the program; return whether there are steps to run.

    Args:
        sliced: Whether to run the program only up to its first step.
        measured: Whether to record the heap's high-water mark after each step, and collect then.
    """
    global _step, _measured
    _measured = measured
    try:
        if sliced:
            import main  # type: ignore[import-not-found]

            main.start()
            _step = main.step
            if measured:
                collect()
            return True
        with open("main.py") as file:
            code = compile(file.read(), "main.py", "exec")
        exec(code, {"__name__": "__main__"})
    except BaseException as error:
        _ended(error)
        return False
    _board.call(_board.ENDED)
    return False


def run_core(name: str) -> bool:
    """Start a module of the program on the second core; return whether there are steps to run."""
    global _step
    try:
        from second_core import (  # type: ignore[import-not-found]
            TO_FIRST,
            TO_SECOND,
            Mailbox,
        )

        core = __import__(name)
        core.start(Mailbox(TO_SECOND), Mailbox(TO_FIRST))
        _step = core.step
        return True
    except BaseException as error:
        _ended(error)
        return False


def imported(line: str) -> None:
    """Run one import of the program when the heap is measured: a board collects meanwhile."""
    try:
        exec(line, {})
    except BaseException:  # reported when the program itself runs the import
        pass
    collect()


def step() -> bool:
    """Run one step; return whether there are more."""
    try:
        _step()  # type: ignore[misc]
        if _measured:
            collect()
    except BaseException as error:
        _ended(error)
        return False
    return True


def collect() -> None:
    """Record the heap's high-water mark; garbage is freed at the return to JavaScript."""
    global _peak
    _peak = max(_peak, gc.mem_alloc())  # type: ignore[attr-defined]
    gc.collect()


def report() -> None:
    """Report the heap in use and its high water since the last report, right after a collection."""
    global _peak
    in_use = gc.mem_alloc()  # type: ignore[attr-defined]
    _board.call(_board.HEAP, f"{in_use} {_peak}".encode())
    _peak = 0


def _ended(error: BaseException) -> None:
    if isinstance(error, SystemExit):
        _board.call(_board.RESET, b"\0")  # as on a board; does not return
    text = io.StringIO()
    sys.print_exception(error, text)  # type: ignore[attr-defined]
    # Modules that are built into a real board's firmware are not in its tracebacks.
    lines = [line for line in text.getvalue().split("\n") if not line.startswith('  File "/shims/')]
    _board.call(_board.ENDED, "\n".join(lines).encode())
