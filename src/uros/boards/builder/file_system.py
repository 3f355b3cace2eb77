"""Makes a board's file system: a program, and of uros and the ROS interfaces what it imports.

::

    build(Path("firmware/greenhouse"), Path("build/greenhouse"))

`uros.boards.builder.resolver` finds the modules, the passes of `uros.boards.builder.pipeline` make
uros's own smaller, and they are written as text or as bytecode. That saves memory and changes
nothing else.

The program's own modules are not rewritten, only compiled: what they mean depends on more than
their text. Other modules read and set their globals, ask for names by ``getattr``, derive from
their classes and print them; they run when they are first imported, and know their own name.
MicroPython's compiler removes annotations and docstrings by itself, and keeps asserts and line
numbers.
"""

from __future__ import annotations

import ast
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Final

from .compiler import bytecode
from .errors import BuildError, FieldError
from .field_check import check_fields
from .modules import Module
from .passes.bundle import NotBundled
from .passes.terse_errors import set_constant
from .pipeline import PASSES, STARTED, Program, run_passes
from .resolver import Resolver

_NOTE: Final = ".made-by-uros"


def build(
    program: Path,
    out: Path,
    form: str = "py",
    *,
    without: Iterable[str] = (),
    roots: Iterable[str] = (),
    provided: Iterable[str] = (),
    checked: bool = False,
) -> list[Path]:
    """Write a board's file system into the folder ``out``; returns its files, sorted.

    ``program`` is a folder: all its files go to the board, but hidden ones and ``.md``. Its Python
    files are where the search for imports starts. Types of interfaces are known as `add_folder` and
    the search path of ROS have them, and imported as ``from sensor_msgs.msg import Temperature``.

    ``form`` is ``"py"``, or ``"mpy"`` for bytecode (the program's main.py and boot.py stay text).
    ``without`` names passes to leave out (`PASSES`). ``terse-errors`` leaves out words: an error of
    packing names the type and not the field, errors of ``uros.wire`` and of received bytes have no
    text, `InterfaceError` is ValueError itself, messages have no text and no field types; a
    received text that is no UTF-8, and data flagged as big-endian (no agent sends such to a board),
    make their message malformed; classes of messages that the program does not import, but others
    nest, are made without arguments; QoS profiles and messages are equal only to themselves.
    ``tree-shake`` drops what the program does not reach; ``roots`` keeps more: modules
    (``uros.wire.session``), names in them (``uros.wire.session:push_info``) and types
    (``std_msgs.msg:Int32``). ``bundle`` and what follows it are for bytecode alone, since a board
    needs more memory to compile one big text than that saves. ``provided`` are further modules that
    the board has by itself. ``checked`` is for virtual boards: messages refuse attributes that are
    no fields, and an error of packing names the field, its value and its range, in a lean build
    too.

    ``out`` is replaced as a whole, once all is made; a folder that holds anything but an earlier
    build is refused. What is wrong with the program raises `BuildError`, what the disk refuses
    OSError; either leaves ``out`` as it was.
    """
    program, out, without = Path(program), Path(out), set(without)
    if form not in ("py", "mpy"):
        raise BuildError(f"no form {form!r}; give 'py' or 'mpy'")
    known = [it.name for it in PASSES]
    for name in sorted(without.difference(known)):
        raise BuildError(f"no pass {name!r} to leave out; there are {', '.join(known)}")
    if out.resolve().is_relative_to(program.resolve()):
        raise BuildError(f"{out} is inside of the program; give a folder beside it")
    search = Resolver(program, set(provided), "terse-errors" not in without, checked)
    work = Program(search.run(tuple(roots)), set(roots), checked)
    if faults := check_fields(work.modules.values()):
        raise FieldError("\n".join(faults))
    if checked:
        set_constant(work.modules, "uros.interfaces.dynamic", "_CHECKED", True)
    try:
        run_passes(work, form, without)
    except NotBundled as error:
        raise BuildError(f"{error}; build it without the pass bundle (--without bundle)") from error
    files = dict(search.other)
    for module in work.modules.values():
        path, data = _file(module, form)
        files[path] = data
    return _replace(out, files)


def _file(module: Module, form: str) -> tuple[str, bytes]:
    text = module.text if module.own else ast.unparse(module.tree) + "\n"
    if form == "py" or (module.own and module.name in STARTED):
        return module.path + ".py", text.encode()
    return module.path + ".mpy", _compile(module, text)


def _compile(module: Module, text: str) -> bytes:
    # The text of our own modules is not what is in their files, so line numbers would mislead.
    level = "-O0" if module.own else "-O3"
    name = Path(module.source).name if module.own else module.path + ".py"
    return bytecode(text, name, module.source, level)


def is_built(folder: Path) -> bool:
    """Whether `build` has made the folder."""
    return (folder / _NOTE).is_file()


def _replace(out: Path, files: dict[str, bytes]) -> list[Path]:
    """Write all beside ``out`` first, so that there is never half of it."""
    if out.is_file() or (out.is_dir() and not (out / _NOTE).exists() and any(out.iterdir())):
        raise BuildError(f"{out} holds something else; give a new folder, or remove it")
    out.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=out.name + ".", dir=out.parent) as made:
        new = Path(made, "new")
        for path, data in files.items():
            file = new / path
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(data)
        (new / _NOTE).touch()
        if out.exists():
            out.rename(Path(made, "old"))
        try:
            new.rename(out)
        except OSError:
            if Path(made, "old").exists():
                Path(made, "old").rename(out)
            raise
    return sorted(out / path for path in files)
