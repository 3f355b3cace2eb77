"""Which names a piece of code binds, and what they mean in inner scopes."""

from __future__ import annotations

import ast
from collections.abc import Iterable, Iterator
from typing import Final

FUNCTIONS: Final = (ast.FunctionDef, ast.AsyncFunctionDef)
COMPREHENSIONS: Final = (ast.ListComp, ast.SetComp, ast.DictComp, ast.GeneratorExp)


def parameters(args: ast.arguments) -> Iterator[str]:
    """The names of a function's parameters, in their order."""
    for arg in (*args.posonlyargs, *args.args, *args.kwonlyargs, args.vararg, args.kwarg):
        if arg:
            yield arg.arg


def bound(statements: Iterable[ast.AST]) -> Iterator[str]:
    """The names that statements bind in their own scope, once for each time."""
    for node in statements:
        if isinstance(node, (*FUNCTIONS, ast.ClassDef)):
            yield node.name
        elif isinstance(node, ast.Lambda):
            continue
        elif isinstance(node, COMPREHENSIONS):
            # Its variables are its own, but for those of :=.
            for inner in ast.walk(node):
                if isinstance(inner, ast.NamedExpr):
                    yield from bound([inner.target])
        elif isinstance(node, ast.Import):
            for alias in node.names:
                yield alias.asname or alias.name.partition(".")[0]
        elif isinstance(node, ast.ImportFrom):
            for alias in node.names:
                yield alias.asname or alias.name
        elif isinstance(node, ast.Name):
            if not isinstance(node.ctx, ast.Load):
                yield node.id
        else:
            if isinstance(node, ast.ExceptHandler) and node.name:
                yield node.name
            yield from bound(ast.iter_child_nodes(node))


def times_bound(tree: ast.Module) -> dict[str, int]:
    """How often each name is bound at the top level, anywhere in a statement of it."""
    times: dict[str, int] = {}
    for name in bound(tree.body):
        times[name] = times.get(name, 0) + 1
    for node in ast.walk(tree):
        if isinstance(node, ast.Global):  # a function may bind it at any time
            for name in node.names:
                times[name] = times.get(name, 0) + 2
    return times


def scoped_names(tree: ast.AST) -> set[str]:
    """All names that functions, lambdas and comprehensions in a tree bind for themselves."""
    names: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, (*FUNCTIONS, ast.Lambda)):
            names.update(parameters(node.args))
            names.update(bound([node.body] if isinstance(node, ast.Lambda) else node.body))
        elif isinstance(node, ast.comprehension):
            names.update(bound([node.target]))
    return names


class Scopes(ast.NodeTransformer):
    """Walks over a module, and knows which names mean something else in an inner scope."""

    def __init__(self) -> None:
        self.scopes: list[tuple[bool, set[str]]] = []  # (is a class, what it binds)

    def hidden(self, name: str) -> bool:
        """Whether the name is not the module's here."""
        innermost = True
        for is_class, names in reversed(self.scopes):
            if name in names and (innermost or not is_class):
                return True
            innermost = False
        return False

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST:
        return self._function(node)

    def visit_AsyncFunctionDef(self, node: ast.AsyncFunctionDef) -> ast.AST:
        return self._function(node)

    def _function(self, node: ast.FunctionDef | ast.AsyncFunctionDef) -> ast.AST:
        node.decorator_list = [self.visit(d) for d in node.decorator_list]
        self._defaults(node.args)
        outside = {name for n in ast.walk(node) if isinstance(n, ast.Global) for name in n.names}
        self.scopes.append((False, set(parameters(node.args)) | set(bound(node.body)) - outside))
        node.body = self._all(node.body)
        self.scopes.pop()
        return node

    def visit_Lambda(self, node: ast.Lambda) -> ast.AST:
        self._defaults(node.args)
        self.scopes.append((False, set(parameters(node.args)) | set(bound([node.body]))))
        node.body = self.visit(node.body)
        self.scopes.pop()
        return node

    def _defaults(self, args: ast.arguments) -> None:
        args.defaults = [self.visit(d) for d in args.defaults]
        args.kw_defaults = [d and self.visit(d) for d in args.kw_defaults]

    def visit_ClassDef(self, node: ast.ClassDef) -> ast.AST:
        node.decorator_list = [self.visit(d) for d in node.decorator_list]
        node.bases = [self.visit(base) for base in node.bases]
        names: set[str] = set()  # a class's body is done in order: in X = X the second is another
        self.scopes.append((True, names))
        body: list[ast.stmt] = []
        for statement in node.body:
            if isinstance(statement, ast.Assign):
                value = self.visit(statement.value)
                statement.value = ast.Constant(None)
                names.update(bound([statement]))
                self.generic_visit(statement)
                statement.value = value
                body.append(statement)
            else:
                names.update(bound([statement]))
                body += self._all([statement])
        node.body = body
        self.scopes.pop()
        return node

    def _all(self, statements: list[ast.stmt]) -> list[ast.stmt]:
        block = ast.Module(statements, [])
        self.generic_visit(block)
        return block.body or [ast.Pass()]

    def _comprehension(self, node: ast.AST) -> ast.AST:
        assert isinstance(node, COMPREHENSIONS)
        # The first iterable belongs to the scope around.
        node.generators[0].iter = self.visit(node.generators[0].iter)
        first, node.generators[0].iter = node.generators[0].iter, ast.Constant(None)
        self.scopes.append((False, set(bound(g.target for g in node.generators))))
        self.generic_visit(node)
        self.scopes.pop()
        node.generators[0].iter = first
        return node

    visit_ListComp = visit_SetComp = visit_DictComp = visit_GeneratorExp = _comprehension


class Renaming(Scopes):
    """Gives a module's names those that `name` says, wherever they are bound or asked for."""

    def name(self, name: str) -> str:
        raise NotImplementedError

    def visit_Name(self, node: ast.Name) -> ast.AST:
        node.id = self.name(node.id)
        return node

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST:
        node.name = self.name(node.name)
        return super().visit_FunctionDef(node)

    def visit_AsyncFunctionDef(self, node: ast.AsyncFunctionDef) -> ast.AST:
        node.name = self.name(node.name)
        return super().visit_AsyncFunctionDef(node)

    def visit_ClassDef(self, node: ast.ClassDef) -> ast.AST:
        node.name = self.name(node.name)
        return super().visit_ClassDef(node)

    def visit_ExceptHandler(self, node: ast.ExceptHandler) -> ast.AST:
        if node.name:
            node.name = self.name(node.name)
        return self.generic_visit(node)
