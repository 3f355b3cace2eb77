"""Builds a board's file system: a program, with what it imports of uros and ROS interfaces.

::

    build(Path("firmware/greenhouse"), Path("build/greenhouse"))

`uros.boards.builder.resolver` finds the modules, the passes of `uros.boards.builder.pipeline` make
the modules of uros smaller, and `build` writes all modules as text or as bytecode. The passes save
memory and keep the behavior, except for what `build` lists.

The program's own modules are compiled but not rewritten, since their behavior depends on more than
their text: other modules read and set their globals, use ``getattr`` for their names, derive from
their classes and print them; they run at their first import, and read their own name. MicroPython's
compiler removes their annotations and docstrings, and keeps asserts and line numbers.
"""

from __future__ import annotations

import ast
from collections.abc import Iterable
from pathlib import Path

from . import cache
from .compiler import bytecode
from .errors import BuildError, FieldError
from .field_check import check_fields
from .modules import Module
from .output import replace
from .passes.bundle import NotBundled
from .passes.terse_errors import set_constant
from .pipeline import PASSES, STARTED, Program, run_passes
from .resolver import Resolver


def build(
    program: Path,
    out: Path,
    form: str = "py",
    *,
    without: Iterable[str] = (),
    roots: Iterable[str] = (),
    provided: Iterable[str] = (),
    checked: bool = False,
    cached: bool = False,
) -> list[Path]:
    """Write a board's file system into the folder ``out``; return its files, sorted.

    Two passes change what a program can observe:

    - ``terse-errors`` shortens errors. A packing error names the type and not the field; errors of
      ``uros.wire`` and of received bytes have no text; `InterfaceError` is ValueError itself;
      messages have no text form and no field types. A received text that is not UTF-8 makes its
      message malformed, and so does data flagged as big-endian (no agent sends such data to a
      board). The constructor of a message class that the program does not import, but other
      messages nest, takes no arguments. QoS profiles and messages are equal only to themselves.
    - ``tree-shake`` removes what the program does not reach; ``roots`` keeps more.

    ``bundle`` and the passes after it run for bytecode only: to compile one large text, a board
    needs more memory than the bundle saves.

    Args:
        program: Folder of the program. All its files go to the board, except hidden files, ``.md``,
            ``secrets.py`` and the folder ``tests``. The search for imports starts at its Python
            files. Interface types come from `add_folder` and the search path of ROS, and are
            imported as ``from sensor_msgs.msg import Temperature``.
        out: Folder to write. It is replaced as a whole after everything is built; a folder that
            holds anything but an earlier build is refused.
        form: ``"py"``, or ``"mpy"`` for bytecode (the program's main.py and boot.py stay text).
        without: Names of passes to leave out (`PASSES`).
        roots: What to keep in addition: modules (``uros.wire.session``), names in modules
            (``uros.wire.session:push_info``) and types (``std_msgs.msg:Int32``).
        provided: Further modules that the board has.
        checked: For virtual boards: messages refuse attributes that are not fields, and a packing
            error names the field, its value and its range, with ``terse-errors`` too.
        cached: Whether an equal build of before may give the files (`cache`).

    Raises:
        BuildError: The program or an argument is wrong; ``out`` is unchanged.
        OSError: The disk refuses a file; ``out`` is unchanged.
    """
    program, out, without = Path(program), Path(out), set(without)
    if form not in ("py", "mpy"):
        raise BuildError(f"no form {form!r}; give 'py' or 'mpy'")
    known = [step.name for step in PASSES]
    for name in sorted(without.difference(known)):
        raise BuildError(f"no pass {name!r} to leave out; there are {', '.join(known)}")
    if out.resolve().is_relative_to(program.resolve()):
        raise BuildError(f"{out} is inside of the program; give a folder beside it")
    roots, provided = tuple(roots), set(provided)
    options = (form, sorted(without), roots, sorted(provided), checked)
    key = cache.key(program, options) if cached else None
    files = cache.read(key) if key else None
    if files is None:
        files = _files(program, form, without, roots, provided, checked)
        if key:
            cache.write(key, files)
    return replace(out, files)


def _files(
    program: Path,
    form: str,
    without: set[str],
    roots: tuple[str, ...],
    provided: set[str],
    checked: bool,
) -> dict[str, bytes]:
    """Return the files of the board by path."""
    resolver = Resolver(program, provided, "terse-errors" not in without, checked)
    board_program = Program(resolver.run(roots), set(roots), checked)
    if faults := check_fields(board_program.modules.values()):
        raise FieldError("\n".join(faults))
    if checked:
        set_constant(board_program.modules, "uros.interfaces.dynamic", "_CHECKED", True)
    try:
        run_passes(board_program, form, without)
    except NotBundled as error:
        raise BuildError(f"{error}; build it without the pass bundle (--without bundle)") from error
    files = dict(resolver.data_files)
    for module in board_program.modules.values():
        path, data = _file(module, form)
        files[path] = data
    return files


def _file(module: Module, form: str) -> tuple[str, bytes]:
    text = module.text if module.own else _unparsed(module.tree)
    if form == "py" or (module.own and module.name in STARTED):
        return module.path + ".py", text.encode()
    return module.path + ".mpy", _compile(module, text)


def _unparsed(tree: ast.Module) -> str:
    # Nodes that passes made have no line numbers, which unparse reads.
    return ast.unparse(ast.fix_missing_locations(tree)) + "\n"


def _compile(module: Module, text: str) -> bytes:
    # The passes changed the text of uros's modules: its line numbers are not those of the files.
    level = "-O0" if module.own else "-O3"
    name = Path(module.source).name if module.own else module.path + ".py"
    return bytecode(text, name, module.source, level)
