"""Gives names that nobody outside of the bundle can see the names that MicroPython has in its ROM.

A new name costs a board some 20 bytes, one that MicroPython itself uses costs none. Renamed are
parameters that no call names, and private attributes that are no methods: tracebacks do not show
them. As with `shake`, a name that is put together at run time is not seen.
"""

from __future__ import annotations

import ast
from collections.abc import Iterable, Iterator
from typing import Final

from .shrink import FUNCTIONS, Module, bound, parameters

# MicroPython numbers these in every build (py/makeqstrdata.py); files of bytecode rely on it.
_IN_ROM: Final = (
    "args clear close const copy count end find format get index insert items join key keys little"
    " lower lstrip next pop popitem pow read readinto readline remove replace reverse rfind rindex"
    " rsplit rstrip send sep setdefault sort split start startswith step stop strip sum throw"
    " update upper value values write"
).split()
_ATTRIBUTES: Final = (
    "ArithmeticError AssertionError AttributeError BaseException EOFError Ellipsis Exception"
    " GeneratorExit ImportError IndentationError IndexError KeyError KeyboardInterrupt LookupError"
    " MemoryError NameError NoneType NotImplementedError OSError OverflowError RuntimeError"
    " StopIteration SyntaxError SystemExit TypeError ValueError ZeroDivisionError"
    " abs all any bool builtins bytearray bytecode bytes callable chr classmethod dict dir divmod"
    " endswith eval exec extend from_bytes getattr globals hasattr hash id int isalpha isdigit"
    " isinstance islower isspace issubclass isupper iter len list locals main map micropython"
    " object open ord print range repr round set setattr sorted staticmethod str super to_bytes"
    " tuple type zip"
).split()


def rename(whole: Module, others: Iterable[Module]) -> None:
    """Rename in the bundle ``whole``; ``others`` are all modules that run beside it."""
    outside = [module.tree for module in others]
    trees = [whole.tree, *outside]
    attributes = {n.attr for tree in trees for n in ast.walk(tree) if isinstance(n, ast.Attribute)}
    kept = _strings(trees) | set(_keywords(trees)) | _all_names(outside)
    _rename_attributes(whole.tree, kept, attributes)
    names = {n.attr for n in ast.walk(whole.tree) if isinstance(n, ast.Attribute)}
    names |= set(bound(whole.tree.body)) | kept | set(_IN_ROM) | {"self"}
    for node in ast.walk(whole.tree):
        if isinstance(node, FUNCTIONS):
            _rename_parameters(node, names)


def _strings(trees: Iterable[ast.AST]) -> set[str]:
    return {
        node.value
        for tree in trees
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    }


def _keywords(trees: Iterable[ast.AST]) -> Iterator[str]:
    for tree in trees:
        for node in ast.walk(tree):
            if isinstance(node, ast.keyword) and node.arg:
                yield node.arg


def _all_names(trees: Iterable[ast.AST]) -> set[str]:
    """Private names that the text has anywhere."""
    names: set[str] = set()
    for tree in trees:
        for node in ast.walk(tree):
            for value in vars(node).values():
                if isinstance(value, str) and value.startswith("_"):
                    names.add(value)
    return names


def _rename_attributes(tree: ast.Module, kept: set[str], attributes: set[str]) -> None:
    bodies = {n.name for n in tree.body if isinstance(n, ast.ClassDef)}
    for node in ast.walk(tree):
        if isinstance(node, FUNCTIONS):
            kept = kept | {node.name}
        elif isinstance(node, ast.ClassDef):
            kept = kept | set(bound(node.body))
            if any(not isinstance(b, ast.Name) or b.id not in bodies for b in node.bases):
                # A base that is not ours may have an attribute of any name.
                kept = kept | {n.attr for n in ast.walk(node) if isinstance(n, ast.Attribute)}
    private = sorted(a for a in attributes if a.startswith("_") and not a.startswith("__"))
    free = [name for name in _ATTRIBUTES if name not in attributes and name not in kept]
    new = dict(zip([name for name in private if name not in kept], free, strict=False))
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute):
            node.attr = new.get(node.attr, node.attr)


def _rename_parameters(function: ast.FunctionDef | ast.AsyncFunctionDef, kept: set[str]) -> None:
    taken = {n.id for n in ast.walk(function) if isinstance(n, ast.Name)}
    taken |= {n.arg for n in ast.walk(function) if isinstance(n, ast.arg)}
    taken |= set(bound(function.body))
    own = set(parameters(function.args)) - kept
    for node in ast.walk(function):
        # What an inner scope binds, and what one shares by name, stays as it is.
        if isinstance(node, ast.ClassDef):
            own -= set(bound(node.body))
        elif isinstance(node, (ast.Global, ast.Nonlocal)):
            own -= set(node.names)
        elif isinstance(node, ast.comprehension):
            own -= set(bound([node.target]))
        elif isinstance(node, (*FUNCTIONS, ast.Lambda)) and node is not function:
            own -= set(parameters(node.args))
            own -= set(bound([node.body] if isinstance(node, ast.Lambda) else node.body))
    free = [name for name in _IN_ROM if name not in taken]
    renamed = [name for name in parameters(function.args) if name in own]
    new = dict(zip(renamed, free, strict=False))
    args = function.args
    for arg in (*args.args, *args.kwonlyargs, args.vararg, args.kwarg):
        if arg:
            arg.arg = new.get(arg.arg, arg.arg)
    for statement in function.body:
        for inner in ast.walk(statement):
            if isinstance(inner, ast.Name):
                inner.id = new.get(inner.id, inner.id)
