"""Gives the names used most the shortest numbers in the bundle's bytecode.

Bytecode refers to a name by its number in a table of the file: one octet for the first 128, two for
the others. mpy-cross numbers names in the order of their first use: names in class bodies, most of
which are used twice, come before all names in methods. The pass therefore adds a first statement
without effect that contains the names used most::

    __name__ or [self.args.data, buf.state]

MicroPython frees the statement with the module's body, as soon as the body has run.
"""

from __future__ import annotations

import ast
import keyword
from collections import Counter
from collections.abc import Iterable
from typing import Final

from ..scopes import bound, parameters, walk

_SHORT: Final = 127
"""Number of names with a number of one octet, without the name of the file itself."""
_INTERNED: Final = 10
"""Longest string that is stored like a name (MICROPY_ALLOC_PARSE_INTERN_STRING_LEN)."""
_CHAIN: Final = 16
"""Longest chain of attributes, so that recursive visitors of the tree stay within limits."""


def order_names(tree: ast.Module) -> None:
    """Insert the statement at the start of a module."""
    count = _Count()
    count.visit(tree)
    names = [name for name, times in count.uses.most_common(_SHORT) if times > 1]
    if not names:
        return
    plain = [name for name in names if name.isidentifier() and not keyword.iskeyword(name)]
    chains = [_chain(plain[i : i + _CHAIN]) for i in range(0, len(plain), _CHAIN)]
    others = [ast.Constant(name) for name in names if name not in plain]
    unevaluated = ast.List([*chains, *others], ast.Load())
    statement = ast.BoolOp(ast.Or(), [ast.Name("__name__", ast.Load()), unevaluated])
    tree.body.insert(0, ast.Expr(statement))


def _chain(names: list[str]) -> ast.expr:
    chain: ast.expr = ast.Name(names[0], ast.Load())
    for name in names[1:]:
        chain = ast.Attribute(chain, name, ast.Load())
    return chain


class _Count(ast.NodeVisitor):
    """Counts how often bytecode refers to each name; local variables have no name there."""

    def __init__(self) -> None:
        self.uses: Counter[str] = Counter()
        self.local: frozenset[str] = frozenset()

    def inside(self, binds: Iterable[str], parts: Iterable[ast.AST]) -> None:
        outer, self.local = self.local, frozenset(binds)
        for part in parts:
            self.visit(part)
        self.local = outer

    def function(self, node: ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda) -> None:
        body = [node.body] if isinstance(node, ast.Lambda) else node.body
        for default in (*node.args.defaults, *filter(None, node.args.kw_defaults)):
            self.visit(default)
        own = list(parameters(node.args))
        self.uses.update(own)
        outside = {name for n in walk(node) if isinstance(n, ast.Global) for name in n.names}
        self.inside(self.local.union(own, set(bound(body)) - outside), body)

    visit_Lambda = function

    def visit_FunctionDef(self, node: ast.FunctionDef | ast.AsyncFunctionDef) -> None:
        self.uses[node.name] += 1 if node.name in self.local else 2
        for decorator in node.decorator_list:
            self.visit(decorator)
        self.function(node)

    visit_AsyncFunctionDef = visit_FunctionDef

    def visit_ClassDef(self, node: ast.ClassDef) -> None:
        self.uses.update((node.name, node.name, node.name))
        self.uses.update(("__name__", "__module__", "__qualname__"))
        for base in node.bases:
            self.visit(base)
        self.inside((), node.body)

    def visit_Name(self, node: ast.Name) -> None:
        if node.id not in self.local:
            self.uses[node.id] += 1

    def visit_Attribute(self, node: ast.Attribute) -> None:
        self.uses[node.attr] += 1
        self.visit(node.value)

    def visit_keyword(self, node: ast.keyword) -> None:
        if node.arg:
            self.uses[node.arg] += 1
        self.visit(node.value)

    def visit_Constant(self, node: ast.Constant) -> None:
        if isinstance(node.value, str) and len(node.value.encode()) <= _INTERNED:
            self.uses[node.value] += 1

    def visit_alias(self, node: ast.alias) -> None:
        self.uses.update((node.name, node.asname or node.name))
