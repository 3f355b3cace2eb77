"""Runs ``main.py`` on MicroPython as a board does, for ``engine_micropython.mjs``."""

import gc
import io
import sys

import _board  # type: ignore[import-not-found]

_step = None
_measured = False
_peak = 0


def run(sliced: bool, measured: bool) -> bool:
    """Run the program; with ``sliced`` only up to its first step. True: there are steps to do.

    ``measured``: note the heap's high water after each step, and collect then.
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
    """Start a module of the program on the second core. True: there are steps to do."""
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
    """Run one import of the program, when the heap is measured: a board collects meanwhile."""
    try:
        exec(line, {})
    except BaseException:  # it will be told when the program itself does it
        pass
    collect()


def step() -> bool:
    """Do one step; whether there are more."""
    try:
        _step()  # type: ignore[misc]
        if _measured:
            collect()
    except BaseException as error:
        _ended(error)
        return False
    return True


def collect() -> None:
    """Note the heap's high water; what is garbage goes at the return to JavaScript."""
    global _peak
    _peak = max(_peak, gc.mem_alloc())  # type: ignore[attr-defined]
    gc.collect()


def report() -> None:
    """Tell the heap in use, right after :func:`collect`."""
    in_use = gc.mem_alloc()  # type: ignore[attr-defined]
    _board.call(_board.HEAP, f"{in_use} {_peak}".encode())


def _ended(error: BaseException) -> None:
    if isinstance(error, SystemExit):
        _board.call(_board.RESET, b"\0")  # as on a board; does not return
    text = io.StringIO()
    sys.print_exception(error, text)  # type: ignore[attr-defined]
    # What is compiled into a real board's firmware does not show up in tracebacks.
    lines = [it for it in text.getvalue().split("\n") if not it.startswith('  File "/shims/')]
    _board.call(_board.ENDED, "\n".join(lines).encode())
