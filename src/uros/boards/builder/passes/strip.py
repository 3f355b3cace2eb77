"""Makes modules of uros smaller for a board, without a change of what they do there.

`strip` takes off what only CPython's tools read; `inline` turns named numbers into literals, across
modules. What nothing reaches is dropped by `shake`. All three change syntax trees in place, and the
result is for MicroPython alone: tests of `sys.implementation.name` are decided here.
"""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import Final

Scalar = int | bool | str | bytes

ABSENT: Final = {
    "__future__", "abc", "collections.abc", "contextlib", "dataclasses", "enum", "functools",
    "threading", "typing", "typing_extensions", "weakref",
}  # fmt: skip
"""Modules of CPython that MicroPython lacks: importing one fails there."""

_PRESENT: Final = {"from sys import print_exception"}
"""What CPython lacks and every board has: no import of these fails there."""

LONGEST: Final = 16
"""Longer constants of text or octets stay names: a copy in each module would cost more."""

FUNCTIONS: Final = (ast.FunctionDef, ast.AsyncFunctionDef)
COMPREHENSIONS: Final = (ast.ListComp, ast.SetComp, ast.DictComp, ast.GeneratorExp)


@dataclass
class Module:
    """One module of a board's file system.

    ``own`` is a module of the program: its text is not changed, and all of it is live.
    """

    name: str
    package: bool
    source: str
    """Where it comes from, for messages."""
    text: str
    tree: ast.Module
    own: bool = False
    finals: set[str] = field(default_factory=set)
    """Names that the module declares Final, found by `strip`."""

    @property
    def path(self) -> str:
        """Its file on the board, without the suffix."""
        return self.name.replace(".", "/") + ("/__init__" if self.package else "")


@dataclass(frozen=True)
class Wanted:
    """One import: ``import module`` (names is None) or ``from module import names``."""

    module: str
    names: tuple[tuple[str, str], ...] | None
    """Pairs of the name there and the name here."""
    line: int
    optional: bool
    """It stands in a try that catches ImportError, or in what that does then."""
    late: bool
    """It stands in a function."""
    perhaps: bool = False
    """That is a method which Python itself calls, so that the program did not ask for it."""


def absolute(node: ast.ImportFrom, module: Module) -> str:
    """The full name of the module that a from-import names."""
    if not node.level:
        return node.module or ""
    parts = module.name.split(".")
    base = parts[: len(parts) - node.level + module.package]
    return ".".join((*base, *(node.module or "").split("."))).strip(".")


def imports(module: Module) -> Iterator[Wanted]:
    """Every import of a module, wherever it stands."""

    def visit(node: ast.AST, optional: bool, late: str) -> Iterator[Wanted]:
        perhaps = late.startswith("__")
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield Wanted(alias.name, None, node.lineno, optional, bool(late), perhaps)
        elif isinstance(node, ast.ImportFrom):
            names = tuple((alias.name, alias.asname or alias.name) for alias in node.names)
            base = absolute(node, module)
            yield Wanted(base, names, node.lineno, optional, bool(late), perhaps)
        elif isinstance(node, ast.Try):
            tolerant = optional or any(catches_import_error(h) for h in node.handlers)
            for child in (*node.body, *node.handlers):
                yield from visit(child, tolerant, late)
            for child in (*node.orelse, *node.finalbody):
                yield from visit(child, optional, late)
        else:
            if isinstance(node, FUNCTIONS):
                late = late or node.name
            for child in ast.iter_child_nodes(node):
                yield from visit(child, optional, late)

    return visit(module.tree, False, "")


def catches_import_error(handler: ast.ExceptHandler) -> bool:
    """Whether an except clause catches a failed import."""
    if handler.type is None:
        return True
    types = handler.type.elts if isinstance(handler.type, ast.Tuple) else [handler.type]
    return any(isinstance(t, ast.Name) and t.id in _IMPORT_ERRORS for t in types)


_IMPORT_ERRORS: Final = {"ImportError", "Exception", "BaseException"}


# --- strip ---------------------------------------------------------------------------------------


def strip(module: Module) -> None:
    """Take annotations, docstrings and imports for type checkers off; note what is Final."""
    for node in module.tree.body:
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            words = ast.unparse(node.annotation).strip("'\"").replace("typing.", "")
            if words == "Final" or words.startswith("Final["):
                module.finals.add(node.target.id)
    module.tree = _Strip().visit(module.tree)


class _Strip(ast.NodeTransformer):
    def __init__(self) -> None:
        self._class = ""

    def _function(self, node: ast.FunctionDef | ast.AsyncFunctionDef) -> ast.AST:
        _mark_receivers(node, self._class)
        node.returns = None
        outer, self._class = self._class, ""
        self.generic_visit(node)
        self._class = outer
        node.body = node.body or [ast.Pass()]
        return node

    visit_FunctionDef = _function
    visit_AsyncFunctionDef = _function

    def visit_ClassDef(self, node: ast.ClassDef) -> ast.AST:
        outer, self._class = self._class, node.name
        self.generic_visit(node)
        self._class = outer
        node.body = node.body or [ast.Pass()]
        return node

    def visit_arg(self, node: ast.arg) -> ast.AST:
        node.annotation = None
        return node

    def visit_AnnAssign(self, node: ast.AnnAssign) -> ast.AST | None:
        if node.value is None:
            return None
        return ast.Assign([node.target], self.visit(node.value), lineno=node.lineno)

    def visit_Expr(self, node: ast.Expr) -> ast.AST | None:
        if isinstance(node.value, ast.Constant):
            return None
        return self.generic_visit(node)

    def visit_Import(self, node: ast.Import) -> ast.AST | None:
        node.names = [alias for alias in node.names if alias.name not in ABSENT]
        return node if node.names else None

    def visit_ImportFrom(self, node: ast.ImportFrom) -> ast.AST | None:
        return None if not node.level and node.module in ABSENT else node

    def visit_Try(self, node: ast.Try) -> ast.AST | list[ast.stmt] | None:
        first = node.body[0]
        if _is_absent(first) and not node.finalbody:
            # On MicroPython the first statement fails, so the handler is all that runs.
            for handler in node.handlers:
                if catches_import_error(handler):
                    return [s for s in self._all(handler.body) if not isinstance(s, ast.Pass)]
        if ast.unparse(first) in _PRESENT and len(node.body) == 1 and not node.finalbody:
            return self._all(node.body)
        self.generic_visit(node)
        node.body = node.body or [ast.Pass()]
        for handler in node.handlers:
            handler.body = handler.body or [ast.Pass()]
        return node

    def visit_If(self, node: ast.If) -> ast.AST | list[ast.stmt] | None:
        if ast.unparse(node.test) in ("TYPE_CHECKING", "typing.TYPE_CHECKING"):
            return self._all(node.orelse)
        return self._block(node)

    def _all(self, statements: list[ast.stmt]) -> list[ast.stmt]:
        """What is left of some statements."""
        block = ast.Module(statements, [])
        self.generic_visit(block)
        return block.body

    def _block(self, node: ast.AST) -> ast.AST:
        self.generic_visit(node)
        assert isinstance(node, (ast.If, ast.For, ast.AsyncFor, ast.While, ast.With, ast.AsyncWith))
        node.body = node.body or [ast.Pass()]
        return node

    visit_For = visit_AsyncFor = visit_While = visit_With = visit_AsyncWith = _block

    def visit_JoinedStr(self, node: ast.JoinedStr) -> ast.AST:
        """What MicroPython's own parser makes of an f-string; its quotes may not nest there."""
        values: list[ast.expr] = []
        text = self._format(node, values, False)
        if not values:
            return ast.Constant(text.format())
        return ast.Call(ast.Attribute(ast.Constant(text), "format", ast.Load()), values, [])

    def _format(self, node: ast.JoinedStr, values: list[ast.expr], in_spec: bool) -> str:
        text = ""
        for part in node.values:
            if isinstance(part, ast.FormattedValue):
                values.append(self.visit(part.value))
                text += "{" + ("!" + chr(part.conversion) if part.conversion > 0 else "")
                if isinstance(part.format_spec, ast.JoinedStr):
                    text += ":" + self._format(part.format_spec, values, True)
                text += "}"
            elif isinstance(part, ast.Constant):
                plain = str(part.value)
                text += plain if in_spec else plain.replace("{", "{{").replace("}", "}}")
        return text


_RECEIVER: Final = "uros_receiver"


def _mark_receivers(node: ast.FunctionDef | ast.AsyncFunctionDef, owner: str) -> None:
    """Note at attributes of ``self`` and of annotated parameters which class they are of."""
    arguments = [*node.args.posonlyargs, *node.args.args]
    types = {
        arg.arg: ast.unparse(arg.annotation).strip("'\"") for arg in arguments if arg.annotation
    }
    if owner and arguments and not node.decorator_list:
        types[arguments[0].arg] = owner
    elif owner and arguments:
        types.pop(arguments[0].arg, None)
    for inner in ast.walk(node):
        if inner is not node and isinstance(inner, (*FUNCTIONS, ast.Lambda)):
            for name in parameters(inner.args):
                types.pop(name, None)
    for name in bound(node.body):
        types.pop(name, None)
    for inner in ast.walk(node):
        if isinstance(inner, ast.Attribute) and isinstance(inner.value, ast.Name):
            kind = types.get(inner.value.id, "")
            if kind.isidentifier() and not hasattr(inner, _RECEIVER):
                setattr(inner, _RECEIVER, kind)


def receiver(node: ast.Attribute) -> str:
    """The class that an attribute is asked of, as the source's annotations say; "" if unknown."""
    return str(getattr(node, _RECEIVER, ""))


def _is_absent(node: ast.stmt) -> bool:
    if isinstance(node, ast.Import):
        return any(alias.name in ABSENT for alias in node.names)
    if not isinstance(node, ast.ImportFrom) or node.level or node.module is None:
        return False
    # A board has types as std_msgs.msg, a host as uros.interfaces.std_msgs.msg.
    of_host = node.module.startswith("uros.interfaces.") and node.module.count(".") > 2
    return of_host or node.module in ABSENT


# --- inline --------------------------------------------------------------------------------------


def inline(modules: dict[str, Module]) -> None:
    """Put the values of Final constants where their names stand, in all modules but the program's.

    Private constants that no name refers to any more are dropped; public ones stay, for `shake`.
    """
    known: dict[str, dict[str, Scalar]] = {name: {} for name in modules}
    stored = {
        node.attr
        for module in modules.values()
        for node in ast.walk(module.tree)
        if isinstance(node, ast.Attribute) and not isinstance(node.ctx, ast.Load)
    }
    ours = [module for module in modules.values() if not module.own]
    for module in ours:
        module.tree = _Fold().visit(module.tree)
    times = {module.name: times_bound(module.tree) for module in ours}
    classes = {it.name: _classes_of_constants(it, times[it.name], stored) for it in ours}
    again = True
    while again:
        again = False
        for module in ours:
            # Constants made of constants: one more round for each step between them.
            once = times[module.name]
            found = _constants(module, _visible(module, known, classes, once), once, stored)
            again = again or found != known[module.name]
            known[module.name] = found
    for module in ours:
        seen = _visible(module, known, classes, times[module.name])
        module.tree = _Inline(seen).visit(module.tree)
        module.tree = _Fold().visit(module.tree)
    used = named_from_outside(modules.values())
    for module in ours:
        _drop_private(module, known[module.name], used)
        ast.fix_missing_locations(module.tree)


@dataclass
class _Visible:
    """What a module's top level sees: constants by name, and modules and classes by name."""

    names: dict[str, Scalar]
    objects: dict[str, dict[str, Scalar]]


def _visible(
    module: Module,
    known: dict[str, dict[str, Scalar]],
    classes: dict[str, dict[str, dict[str, Scalar]]],
    times: dict[str, int],
) -> _Visible:
    seen = _Visible(dict(known[module.name]), dict(classes[module.name]))
    for node in module.tree.body:
        if isinstance(node, ast.ImportFrom):
            base = absolute(node, module)
            for alias in node.names:
                here = alias.asname or alias.name
                if times.get(here) != 1:
                    continue
                if alias.name in known.get(base, {}):
                    seen.names[here] = known[base][alias.name]
                elif alias.name in classes.get(base, {}):
                    seen.objects[here] = classes[base][alias.name]
                elif f"{base}.{alias.name}" in known:
                    seen.objects[here] = known[f"{base}.{alias.name}"]
        elif isinstance(node, ast.Import):
            for alias in node.names:
                if alias.asname and alias.name in known and times.get(alias.asname) == 1:
                    seen.objects[alias.asname] = known[alias.name]
    return seen


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


def _constants(
    module: Module, seen: _Visible, times: dict[str, int], stored: set[str]
) -> dict[str, Scalar]:
    """The constants that a module defines: Final ones, and private ones that are never changed."""
    found: dict[str, Scalar] = {}
    for node in module.tree.body:
        if not isinstance(node, ast.Assign) or len(node.targets) != 1:
            continue
        target = node.targets[0]
        if not isinstance(target, ast.Name) or times[target.id] != 1 or target.id in stored:
            continue
        if target.id not in module.finals and not _is_private(target.id):
            continue
        value = _small_value(node.value, seen)
        if value is not None:
            found[target.id] = value
    return found


def _classes_of_constants(
    module: Module, times: dict[str, int], stored: set[str]
) -> dict[str, dict[str, Scalar]]:
    """The classes of a module that are lists of constants, such as policies of QoS."""
    found: dict[str, dict[str, Scalar]] = {}
    nothing = _Visible({}, {})
    for node in module.tree.body:
        if not isinstance(node, ast.ClassDef) or node.bases or node.keywords:
            continue
        names = list(bound(node.body))
        given = [_small_value(it.value, nothing) for it in node.body if isinstance(it, ast.Assign)]
        values = {name: it for name, it in zip(names, given, strict=False) if it is not None}
        plain = len(values) == len(names) == len(node.body) and not stored.intersection(names)
        if plain and times[node.name] == 1 and not node.decorator_list:
            found[node.name] = values
    return found


def _is_private(name: str) -> bool:
    return name.startswith("_") and not name.startswith("__")


def _small_value(node: ast.expr, seen: _Visible) -> Scalar | None:
    """The value of a constant expression, None where it is none or a long text."""
    value = _value(node, seen)
    return None if isinstance(value, (str, bytes)) and len(value) > LONGEST else value


def _value(node: ast.expr, seen: _Visible) -> Scalar | None:
    """The value of a constant expression, None where it is none."""
    if isinstance(node, ast.Constant):
        return node.value if isinstance(node.value, (int, bool, str, bytes)) else None
    if isinstance(node, ast.Name):
        return seen.names.get(node.id)
    if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
        return seen.objects.get(node.value.id, {}).get(node.attr)
    if isinstance(node, ast.UnaryOp) and type(node.op) in _UNARY:
        value = _value(node.operand, seen)
        return _UNARY[type(node.op)](value) if type(value) is int else None
    if isinstance(node, ast.BinOp) and type(node.op) in _BINARY:
        left, right = _value(node.left, seen), _value(node.right, seen)
        if type(left) is int and type(right) is int:
            try:
                return _BINARY[type(node.op)](left, right)
            except (ArithmeticError, ValueError):
                return None
    return None


_UNARY: Final[dict[type[ast.unaryop], Callable[[int], int]]] = {
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
    ast.Invert: operator.invert,
}
_BINARY: Final[dict[type[ast.operator], Callable[[int, int], int]]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.FloorDiv: operator.floordiv,
    ast.Mod: operator.mod,
    ast.LShift: operator.lshift,
    ast.RShift: operator.rshift,
    ast.BitOr: operator.or_,
    ast.BitAnd: operator.and_,
    ast.BitXor: operator.xor,
}


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


class _Inline(Scopes):
    """Puts values in, where no inner scope has the name for something else."""

    def __init__(self, seen: _Visible) -> None:
        super().__init__()
        self.seen = seen

    def visit_Name(self, node: ast.Name) -> ast.expr:
        if isinstance(node.ctx, ast.Load) and node.id in self.seen.names:
            if not self.hidden(node.id):
                return _literal(self.seen.names[node.id], node)
        return node

    def visit_Attribute(self, node: ast.Attribute) -> ast.AST:
        base = node.value
        if isinstance(base, ast.Name) and isinstance(node.ctx, ast.Load):
            values = self.seen.objects.get(base.id, {})
            if node.attr in values and not self.hidden(base.id):
                return _literal(values[node.attr], node)
        return self.generic_visit(node)


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


def parameters(args: ast.arguments) -> Iterator[str]:
    """The names of a function's parameters, in their order."""
    for arg in (*args.posonlyargs, *args.args, *args.kwonlyargs, args.vararg, args.kwarg):
        if arg:
            yield arg.arg


def _literal(value: Scalar, at: ast.AST) -> ast.expr:
    if type(value) is int and value < 0:
        return ast.copy_location(ast.UnaryOp(ast.USub(), ast.Constant(-value)), at)
    return ast.copy_location(ast.Constant(value), at)


def named_from_outside(modules: Iterable[Module]) -> set[str]:
    """Names by which another module may take one: of imports, attributes, and in strings."""
    used: set[str] = set()
    for module in modules:
        for node in ast.walk(module.tree):
            if isinstance(node, ast.Attribute):
                used.add(node.attr)
            elif isinstance(node, ast.ImportFrom):
                used.update(alias.name for alias in node.names)
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                used.add(node.value)
    return used


def _drop_private(module: Module, names: Iterable[str], used: set[str]) -> None:
    private = {name for name in names if _is_private(name)} - used
    for node in ast.walk(module.tree):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load):
            private.discard(node.id)
    module.tree.body = [
        node
        for node in module.tree.body
        if not (
            isinstance(node, ast.Assign)
            and isinstance(node.targets[0], ast.Name)
            and node.targets[0].id in private
        )
    ]


class _Fold(ast.NodeTransformer):
    """Decides what is known before the program runs: on which Python, and constants in ifs."""

    def visit_Attribute(self, node: ast.Attribute) -> ast.AST:
        if ast.unparse(node) == "sys.implementation.name":
            return ast.copy_location(ast.Constant("micropython"), node)
        if ast.unparse(node) == "sys.byteorder":  # of all boards that there are files for
            return ast.copy_location(ast.Constant("little"), node)
        return self.generic_visit(node)

    def visit_Compare(self, node: ast.Compare) -> ast.AST:
        self.generic_visit(node)
        values = [node.left, *node.comparators]
        if len(values) == 2 and all(isinstance(v, ast.Constant) for v in values):
            left, right = (v.value for v in values if isinstance(v, ast.Constant))
            if isinstance(left, str) and isinstance(right, str):
                if isinstance(node.ops[0], ast.Eq):
                    return ast.copy_location(ast.Constant(left == right), node)
                if isinstance(node.ops[0], ast.NotEq):
                    return ast.copy_location(ast.Constant(left != right), node)
        return node

    def visit_UnaryOp(self, node: ast.UnaryOp) -> ast.AST:
        self.generic_visit(node)
        known = _truth(node.operand)
        if isinstance(node.op, ast.Not) and known is not None:
            return ast.copy_location(ast.Constant(not known), node)
        return node

    def visit_BoolOp(self, node: ast.BoolOp) -> ast.AST:
        self.generic_visit(node)
        ends = isinstance(node.op, ast.Or)
        values = []
        for i, value in enumerate(node.values):
            known = _truth(value)
            if known is not None and known != ends and i + 1 < len(node.values):
                continue  # it decides nothing, and something follows
            values.append(value)
            if known == ends:
                break
        if len(values) == 1:
            return values[0]
        node.values = values
        return node

    def visit_ClassDef(self, node: ast.ClassDef) -> ast.AST:
        self.generic_visit(node)
        if [ast.unparse(base) for base in node.bases] == ["object"]:
            node.bases = []  # it is one without saying so, and a base takes memory
        return node

    def visit_IfExp(self, node: ast.IfExp) -> ast.AST:
        self.generic_visit(node)
        known = _truth(node.test)
        return node if known is None else node.body if known else node.orelse

    def visit_If(self, node: ast.If) -> ast.AST | list[ast.stmt]:
        self.generic_visit(node)
        known = _truth(node.test)
        if known is None:
            node.body = node.body or [ast.Pass()]
            return node
        return (node.body if known else node.orelse) or [ast.Pass()]


def _truth(node: ast.expr) -> bool | None:
    """Whether a bool constant is true; None for anything else."""
    return node.value if isinstance(node, ast.Constant) and type(node.value) is bool else None
