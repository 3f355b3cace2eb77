"""The passes of a build over uros's modules, in their order.

Each pass makes the files smaller and keeps the behavior of the program. `PASSES` declares each one
with its purpose and its condition: to what it applies, and what it leaves unchanged because the
behavior would not be provably the same. ``uros board build --without PASS`` leaves one out: if a
program behaves differently on the board, this shows which pass is at fault.

No pass changes a module of the program, except `link_imports`; see its docstring. Before the passes
each module of uros is translated for MicroPython (`uros.boards.builder.passes.strip`), without
which it does not run on a board.

To add a pass, write a module of its name in ``passes`` and add it to `PASSES` in the right order.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Final

from .modules import Module, known_names
from .passes.bundle import BUNDLE, bundle
from .passes.constants import inline_constants
from .passes.inline_methods import inline_methods
from .passes.link_imports import link_imports
from .passes.mangle import mangle
from .passes.merge_classes import merge_classes
from .passes.order_names import order_names
from .passes.terse_errors import make_errors_terse
from .passes.tree_shake import tree_shake

STARTED: Final = {"boot", "main"}
"""The modules that MicroPython starts from text, so that they are never compiled."""


@dataclass
class Program:
    """The modules that the passes change."""

    modules: dict[str, Module]
    """All modules of a board, by their names."""
    roots: set[str]
    """Further modules and names to keep; see `tree_shake`."""
    checked: bool = False
    """Whether the build is for a virtual board: errors about messages then keep their texts."""


@dataclass(frozen=True)
class Pass:
    """One pass of a build."""

    name: str
    """Argument of ``--without``; its module in ``passes`` has this name with underscores."""
    purpose: str
    """What it does, in one line."""
    condition: str
    """To what it applies, and what it leaves unchanged or refuses."""
    run: Callable[[Program], None]
    """Changes a program; may raise NotBundled."""
    bytecode: bool = False
    """Whether it is for ``--mpy`` alone, because its result as text would take more memory."""


def _terse_errors(program: Program) -> None:
    make_errors_terse(program.modules, "uros.interfaces." if program.checked else "-")


def _constants(program: Program) -> None:
    inline_constants(program.modules)


def _tree_shake(program: Program) -> None:
    program.modules = tree_shake(program.modules, program.roots)


def _bundle(program: Program) -> None:
    program.modules = bundle(program.modules)


def _link_imports(program: Program) -> None:
    link_imports(program.modules, BUNDLE, lambda module: module.own and module.name in STARTED)


def _on_bundle(change: Callable[[Module, list[Module]], None]) -> Callable[[Program], None]:
    """Return a pass over the bundle alone; ``change`` gets the bundle, and all other modules."""

    def run(program: Program) -> None:
        bundled = program.modules.get(BUNDLE)
        if bundled:
            other_modules = [module for module in program.modules.values() if module is not bundled]
            change(bundled, other_modules)

    return run


def _merge_classes(bundled: Module, other_modules: list[Module]) -> None:
    merge_classes(bundled.tree, known_names(bundled.tree, other_modules))


def _inline_methods(bundled: Module, other_modules: list[Module]) -> None:
    inline_methods(bundled.tree, known_names(bundled.tree, other_modules))


def _order_names(bundled: Module, other_modules: list[Module]) -> None:
    order_names(bundled.tree)


PASSES: Final = (
    Pass(
        "terse-errors",
        "shortens errors, and omits comparing and printing messages",
        "modules of uros, without those of uros.interfaces in a build for a virtual board;"
        " DecodeError, LimitError and EncodeError become WireError, except those that the program"
        " names",
        _terse_errors,
    ),
    Pass(
        "constants",
        "replaces the names of constants by their values",
        "Final or private names that are bound once and that nothing sets as an attribute; values"
        " that are integers, bools, or strings of up to 16 characters; not where an inner scope"
        " binds the same name",
        _constants,
    ),
    Pass(
        "tree-shake",
        "drops what the program does not reach",
        "a method stays if code that stays uses its name on an object of unknown class; a class"
        " with a base outside of uros keeps all its methods; a name that the program composes at"
        " run time is not found",
        _tree_shake,
    ),
    Pass(
        "bundle",
        "joins all modules into one, which the passes below change",
        "refuses a program that sets a name of a module of uros, or uses such a module as a value",
        _bundle,
        bytecode=True,
    ),
    Pass(
        "link-imports",
        "lets the program's modules import from the bundle itself",
        "only 'from module import name'; not in main.py and boot.py, which stay text",
        _link_imports,
        bytecode=True,
    ),
    Pass(
        "merge-classes",
        "merges a class with its only subclass",
        "only the subclass names the base; both bodies only bind methods and constants, each name"
        " once; super() appears only to get an overridden method",
        _on_bundle(_merge_classes),
        bytecode=True,
    ),
    Pass(
        "inline-methods",
        "replaces the only call of a method by its body",
        "its own class calls it once, on self, and ignores its value; each variable is bound before"
        " it is read; no inner scope, generator, coroutine or global statement",
        _on_bundle(_inline_methods),
        bytecode=True,
    ),
    Pass(
        "mangle",
        "renames internals to shorter names, or to names in MicroPython's ROM",
        "names that neither the program nor another module outside of the bundle contains, as a"
        " name or as a string; exceptions, and attributes of modules, of MicroPython's own objects"
        " and of classes with a base outside of uros, keep their names",
        _on_bundle(mangle),
        bytecode=True,
    ),
    Pass(
        "order-names",
        "gives the names used most the shortest numbers in the bytecode",
        "every bundle; adds one statement without effect, which costs more than it saves in a very"
        " small program",
        _on_bundle(_order_names),
        bytecode=True,
    ),
)
"""All passes, in their order."""


def run_passes(program: Program, form: str, without: Iterable[str] = ()) -> None:
    """Run the passes that a form of build has.

    Args:
        program: Changed in place.
        form: ``"py"`` or ``"mpy"``; see `uros.boards.builder.file_system.build`.
        without: Names of passes to leave out.

    Raises:
        NotBundled: The modules cannot become one.
    """
    for step in PASSES:
        if step.name not in without and (form == "mpy" or not step.bytecode):
            step.run(program)
