"""Traverses code; finds which names it binds, and which of them an inner scope hides."""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterable, Iterator
from typing import Any, Final

FUNCTIONS: Final = (ast.FunctionDef, ast.AsyncFunctionDef)
COMPREHENSIONS: Final = (ast.ListComp, ast.SetComp, ast.DictComp, ast.GeneratorExp)
# Fields of nodes without a node below.
_PLAIN: Final = {
    "ctx", "id", "attr", "arg", "kind", "level", "module", "type_comment", "asname", "simple",
    "conversion", "is_async", "type_ignores",
}  # fmt: skip


class _Fields(dict[type[ast.AST], tuple[str, ...]]):
    """The fields that may have nodes, by the class of a node."""

    def __missing__(self, kind: type[ast.AST]) -> tuple[str, ...]:
        self[kind] = tuple(name for name in kind._fields if name not in _PLAIN)
        return self[kind]


_LEAVES: Final = (ast.Constant, ast.Global, ast.Nonlocal, ast.Pass, ast.Break, ast.Continue)
_fields = _Fields(dict.fromkeys(_LEAVES, ()))


class Transformer(ast.NodeTransformer):
    """A faster NodeTransformer, which does not visit the contexts (Load, Store, Del)."""

    def __init__(self) -> None:
        self._visitors: dict[type, Callable[[ast.AST], Any]] = {}

    def visit(self, node: ast.AST) -> Any:
        """Visit a node by the method for its class."""
        kind = type(node)
        if kind not in self._visitors:
            self._visitors[kind] = getattr(self, f"visit_{kind.__name__}", self.generic_visit)
        return self._visitors[kind](node)

    def generic_visit(self, node: ast.AST) -> ast.AST:
        """Visit the nodes below a node, and put there what the visits return."""
        for name in _fields[type(node)]:
            value = getattr(node, name, None)
            if isinstance(value, list):
                value[:] = self._visited(value)
            elif isinstance(value, ast.AST):
                new = self.visit(value)
                if new is None:
                    delattr(node, name)
                elif new is not value:
                    setattr(node, name, new)
        return node

    def _visited(self, values: list[Any]) -> list[Any]:
        out: list[Any] = []
        for value in values:
            if isinstance(value, ast.AST):
                value = self.visit(value)
                if value is None:
                    continue
                if not isinstance(value, ast.AST):
                    out.extend(value)
                    continue
            out.append(value)
        return out


def walk(node: ast.AST) -> Iterator[ast.AST]:
    """Yield a node and all nodes below, breadth first.

    It is a faster :func:`ast.walk`, without the contexts (Load, Store, Del): the passes traverse
    the same trees again and again.
    """
    nodes = [node]
    for node in nodes:  # which grows meanwhile
        for name in _fields[type(node)]:
            value = getattr(node, name, None)
            if isinstance(value, list):
                nodes += [item for item in value if isinstance(item, ast.AST)]
            elif isinstance(value, ast.AST):
                nodes.append(value)
        yield node


def parameters(args: ast.arguments) -> Iterator[str]:
    """Yield the names of a function's parameters, those of ``*args`` and ``**kwargs`` last."""
    for arg in (*args.posonlyargs, *args.args, *args.kwonlyargs, args.vararg, args.kwarg):
        if arg:
            yield arg.arg


def bound(statements: Iterable[ast.AST]) -> Iterator[str]:
    """Yield the names that statements bind in their own scope, once for each binding."""
    waiting = list(statements)[::-1]  # the last one is next
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.Name):
            if not isinstance(node.ctx, ast.Load):
                yield node.id
        elif isinstance(node, (ast.Constant, ast.Lambda)):
            continue
        elif isinstance(node, (*FUNCTIONS, ast.ClassDef)):
            yield node.name
        elif isinstance(node, COMPREHENSIONS):
            # The variables of a comprehension are local; its := binds in the enclosing scope.
            waiting += [n.target for n in walk(node) if isinstance(n, ast.NamedExpr)][::-1]
        elif isinstance(node, ast.Import):
            for alias in node.names:
                yield alias.asname or alias.name.partition(".")[0]
        elif isinstance(node, ast.ImportFrom):
            for alias in node.names:
                yield alias.asname or alias.name
        else:
            if isinstance(node, ast.ExceptHandler) and node.name:
                yield node.name
            waiting += [*ast.iter_child_nodes(node)][::-1]


def times_bound(tree: ast.Module) -> dict[str, int]:
    """Count how often each name is bound at module level, nested blocks included."""
    times: dict[str, int] = {}
    for name in bound(tree.body):
        times[name] = times.get(name, 0) + 1
    for node in walk(tree):
        if isinstance(node, ast.Global):  # a function may bind it any number of times
            for name in node.names:
                times[name] = times.get(name, 0) + 2
    return times


def scoped_names(tree: ast.AST) -> set[str]:
    """Return all names that functions, lambdas and comprehensions in a tree bind locally."""
    names: set[str] = set()
    for node in walk(tree):
        if isinstance(node, (*FUNCTIONS, ast.Lambda)):
            names.update(parameters(node.args))
            names.update(bound([node.body] if isinstance(node, ast.Lambda) else node.body))
        elif isinstance(node, ast.comprehension):
            names.update(bound([node.target]))
    return names


class Scopes(Transformer):
    """Traverses a module and tracks which of its names an inner scope hides."""

    def __init__(self) -> None:
        super().__init__()
        self.scopes: list[tuple[bool, set[str]]] = []  # (whether it is a class, the names it binds)

    def hidden(self, name: str) -> bool:
        """Whether a name at the current node is local and not the module's."""
        innermost = True
        for is_class, names in reversed(self.scopes):
            if name in names and (innermost or not is_class):
                return True
            innermost = False
        return False

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST:
        """Visit a function: its decorators and defaults belong to the scope around it."""
        return self._function(node)

    def visit_AsyncFunctionDef(self, node: ast.AsyncFunctionDef) -> ast.AST:
        """Visit a coroutine function as `visit_FunctionDef` does."""
        return self._function(node)

    def _function(self, node: ast.FunctionDef | ast.AsyncFunctionDef) -> ast.AST:
        node.decorator_list = [self.visit(d) for d in node.decorator_list]
        self._defaults(node.args)
        outside = {name for n in walk(node) if isinstance(n, ast.Global) for name in n.names}
        self.scopes.append((False, set(parameters(node.args)) | set(bound(node.body)) - outside))
        node.body = self._all(node.body)
        self.scopes.pop()
        return node

    def visit_Lambda(self, node: ast.Lambda) -> ast.AST:
        """Visit a lambda: its defaults belong to the scope around it."""
        self._defaults(node.args)
        self.scopes.append((False, set(parameters(node.args)) | set(bound([node.body]))))
        node.body = self.visit(node.body)
        self.scopes.pop()
        return node

    def _defaults(self, args: ast.arguments) -> None:
        args.defaults = [self.visit(d) for d in args.defaults]
        args.kw_defaults = [d and self.visit(d) for d in args.kw_defaults]

    def visit_ClassDef(self, node: ast.ClassDef) -> ast.AST:
        """Visit a class: its names are visible in its body alone, each from its binding on."""
        node.decorator_list = [self.visit(d) for d in node.decorator_list]
        node.bases = [self.visit(base) for base in node.bases]
        names: set[str] = set()  # a class body runs in order: in X = X the second X is from outside
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
        # The first iterable is evaluated in the scope around the comprehension.
        node.generators[0].iter = self.visit(node.generators[0].iter)
        first, node.generators[0].iter = node.generators[0].iter, ast.Constant(None)
        self.scopes.append((False, set(bound(g.target for g in node.generators))))
        self.generic_visit(node)
        self.scopes.pop()
        node.generators[0].iter = first
        return node

    visit_ListComp = visit_SetComp = visit_DictComp = visit_GeneratorExp = _comprehension


class Renaming(Scopes):
    """Renames names of a module by `name`, wherever they are bound or read."""

    def name(self, name: str) -> str:
        """Return the new form of a name, or the name itself to keep it. Subclasses define it."""
        raise NotImplementedError

    def visit_Name(self, node: ast.Name) -> ast.AST:
        """Rename a name that is read, bound or deleted."""
        node.id = self.name(node.id)
        return node

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST:
        """Rename a function."""
        node.name = self.name(node.name)
        return super().visit_FunctionDef(node)

    def visit_AsyncFunctionDef(self, node: ast.AsyncFunctionDef) -> ast.AST:
        """Rename a coroutine function."""
        node.name = self.name(node.name)
        return super().visit_AsyncFunctionDef(node)

    def visit_ClassDef(self, node: ast.ClassDef) -> ast.AST:
        """Rename a class."""
        node.name = self.name(node.name)
        return super().visit_ClassDef(node)

    def visit_ExceptHandler(self, node: ast.ExceptHandler) -> ast.AST:
        """Rename the variable of an ``except`` clause."""
        if node.name:
            node.name = self.name(node.name)
        return self.generic_visit(node)
