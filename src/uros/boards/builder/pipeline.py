"""The passes of a build: what is done to uros's modules, in this order.

Each makes a program smaller and changes nothing else that it does; `uros board build --without`
leaves one out, which tells in a minute which of them is at fault where a program does something
else on the board. None of them touches a module of the program, but `link-imports` as its own
docstring says.

Before them, each module of uros is translated for MicroPython (`shrink.strip`): that takes off what
only CPython's tools read, and is needed to run at all.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Final

from .passes.bundle import BUNDLE
from .passes.bundle import bundle as bundle_modules
from .passes.inline_methods import unfold
from .passes.link_imports import link
from .passes.mangle import fixed_names, rename
from .passes.merge_classes import flatten
from .passes.order_names import order
from .passes.strip import Module, inline
from .passes.terse_errors import make_lean
from .passes.tree_shake import shake

STARTED: Final = {"boot", "main"}
"""MicroPython starts these by their text, so they are never compiled."""


@dataclass
class Program:
    """What the passes work on: all modules of a board, by their names."""

    modules: dict[str, Module]
    roots: set[str]
    """Further modules and names to keep, see `shake`."""
    checked: bool = False
    """For a virtual board: errors of messages keep their words."""


@dataclass(frozen=True)
class Pass:
    name: str
    purpose: str
    """In a line, for the help."""
    run: Callable[[Program], None]
    bytecode: bool = False
    """It is for modules that are compiled: as text they would cost a board more than it saves."""


def _lean(program: Program) -> None:
    make_lean(program.modules, "uros.interfaces." if program.checked else "-")


def _inline(program: Program) -> None:
    inline(program.modules)


def _shake(program: Program) -> None:
    program.modules = shake(program.modules, program.roots)


def _bundle(program: Program) -> None:
    program.modules = bundle_modules(program.modules)


def _link(program: Program) -> None:
    link(program.modules, BUNDLE, lambda module: module.own and module.name in STARTED)


def _of_bundle(change: Callable[[Module, list[Module]], None]) -> Callable[[Program], None]:
    """A pass over the bundle alone; ``change`` gets it, and all modules beside it."""

    def run(program: Program) -> None:
        whole = program.modules.get(BUNDLE)
        if whole:
            others = [module for module in program.modules.values() if module is not whole]
            change(whole, others)
            ast.fix_missing_locations(whole.tree)

    return run


def _flatten(whole: Module, others: list[Module]) -> None:
    flatten(whole.tree, fixed_names(whole.tree, others))


def _order(whole: Module, others: list[Module]) -> None:
    order(whole.tree)


def _unfold(whole: Module, others: list[Module]) -> None:
    unfold(whole.tree, fixed_names(whole.tree, others))


PASSES: Final = (
    Pass("terse-errors", "shortens errors, and leaves out comparing and printing", _lean),
    Pass("constants", "puts named numbers where their names stand", _inline),
    Pass("tree-shake", "drops what the program does not reach", _shake),
    Pass("bundle", "makes one module of all; the passes below work on that", _bundle, True),
    Pass("link-imports", "lets modules import from the bundle itself", _link, True),
    Pass("merge-classes", "makes one of a class and its only heir", _of_bundle(_flatten), True),
    Pass("inline-methods", "puts a method where its only call is", _of_bundle(_unfold), True),
    Pass("mangle", "gives names that nobody sees shorter ones", _of_bundle(rename), True),
    Pass("order-names", "gives the names used most the shortest numbers", _of_bundle(_order), True),
)
"""All passes, in their order."""


def run_passes(program: Program, form: str, without: Iterable[str] = ()) -> None:
    """Run all passes for a form of `build` but some. Raises NotBundled."""
    for it in PASSES:
        if it.name not in without and (form == "mpy" or not it.bytecode):
            it.run(program)
