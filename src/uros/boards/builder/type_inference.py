"""Infers which expressions of a program are messages, and of which type.

The type of an expression is known only if all its bindings have that type: for a name, all
assignments in its scope; for an attribute of ``self``, all stores in the program; for a parameter,
its annotation, or all calls and registrations of its function. An unknown type is None.
"""

from __future__ import annotations

import ast
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from typing import Any, Final

from .inferred_values import (
    NOTHING,
    Value,
    definition,
    element_of,
    field_value,
    imported_value,
    instance,
    join,
    package,
)
from .modules import Module, absolute
from .scopes import FUNCTIONS, walk

Binding = Callable[[], Value]
Function = ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda

# Functions that register a callback. For each: position and name of its argument that is the
# interface type, position and name of its argument that is the callback, and what the callback's
# parameters are.
_REGISTER: Final = {
    "create_subscription": (0, "msg_type", 2, "callback", ("message",)),
    "create_service": (0, "srv_type", 2, "callback", ("request", "response")),
    "ActionServer": (1, "action_type", 3, "execute_callback", ("goal",)),
}
_UNTYPED: Final = {"Any", "object"}


class _Scope:
    """The scope of a module, class, function or comprehension, with the bindings of its names."""

    def __init__(self, module: Module, node: ast.AST, parent: _Scope | None) -> None:
        self.module = module
        self.node = node
        self.parent = parent
        self.top: _Scope = parent.top if parent else self
        self.names: defaultdict[str, list[Binding]] = defaultdict(list)
        self.outer: dict[str, bool] = {}  # names declared global (True) or nonlocal (False)
        self.returns: list[ast.expr] = []
        # Whether it is neither a coroutine nor a generator: a call then has the value that the
        # function returns.
        self.is_plain = not isinstance(node, ast.AsyncFunctionDef)

    def binding_scope(self, name: str) -> _Scope | None:
        """Return the scope that binds a name which is used in this scope, or None."""
        if name in self.outer:
            if self.outer[name]:
                return self.top
            return self.parent.binding_scope(name) if self.parent else None
        scope: _Scope | None = self
        while scope is not None:
            visible = scope is self or not isinstance(scope.node, ast.ClassDef)
            if visible and name in scope.names:
                return scope
            scope = scope.parent
        return None


class Program:
    """The modules of a program with their scopes, for the inference of types.

    ``classes``, ``stores`` and ``references`` cover all modules. They map a name to the classes of
    that name, to the assignments to attributes of that name, and to the uses of that name.
    """

    def __init__(self, modules: list[Module]) -> None:
        self.modules = modules
        self.scopes: dict[ast.AST, _Scope] = {}  # the scope of each node
        self.parents: dict[ast.AST, ast.AST] = {}
        self.tops: dict[str, _Scope] = {}
        self.classes: dict[str, list[ast.ClassDef]] = defaultdict(list)
        self.stores: dict[str, list[tuple[ast.Attribute, Binding]]] = defaultdict(list)
        self.references: dict[str, list[ast.AST]] = defaultdict(list)
        # Constant names given to hasattr, getattr, setattr or delattr.
        self.dynamic_names: set[str] = set()
        self.dynamic_setattr = False  # setattr is called with a name that is not a constant
        self.inner_scopes: dict[ast.AST, _Scope] = {}  # the scope that each node opens
        self._values: dict[object, Value] = {}
        self._in_progress: set[object] = set()
        self._cycles = 0
        for module in modules:
            _Collector(self, module)

    # --- values of expressions ----------------------------------------------------------------

    def infer(self, node: ast.expr) -> Value:
        """Return the value of an expression; None if it is unknown."""
        return self._memoized(node, lambda: self._infer(node))

    def _memoized(self, key: object, find: Binding) -> Value:
        if key in self._values:
            return self._values[key]
        if key in self._in_progress:
            self._cycles += 1
            # The value depends on itself. NOTHING has no effect in join, so the value's other
            # bindings decide.
            return NOTHING
        before = self._cycles
        self._in_progress.add(key)
        try:
            value = find()
        finally:
            self._in_progress.discard(key)
        # A value that was inferred within a cycle is provisional, because some of its bindings were
        # ignored. It is not kept, unless the inference began with it.
        if self._cycles == before or not self._in_progress:
            self._values[key] = value
        return value

    def _infer(self, node: ast.expr) -> Value:
        if isinstance(node, ast.Constant):
            return NOTHING if node.value is None else None
        if isinstance(node, ast.Name):
            return self.name(node.id, self.scopes[node])
        if isinstance(node, ast.Attribute):
            return self.attribute(self.infer(node.value), node.attr)
        if isinstance(node, ast.Call):
            return self.call(node)
        if isinstance(node, ast.IfExp):
            return join([self.infer(node.body), self.infer(node.orelse)])
        if isinstance(node, ast.NamedExpr):
            return self.infer(node.value)
        if isinstance(node, ast.Subscript) and not isinstance(node.slice, ast.Slice):
            return element_of(self.infer(node.value))
        if isinstance(node, (ast.List, ast.Tuple)) and node.elts:
            value = join(list(map(self.infer, node.elts)))
            return ("sequence", value) if value and value != NOTHING else None
        if isinstance(node, ast.ListComp):
            value = self.infer(node.elt)
            return ("sequence", value) if value and value != NOTHING else None
        return None

    def name(self, name: str, scope: _Scope) -> Value:
        """Return the value of a name that is used in ``scope``."""
        owner = scope.binding_scope(name)
        if owner is None:
            return None
        bindings = owner.names[name]
        return self._memoized((owner, name), lambda: join([binding() for binding in bindings]))

    def attribute(self, value: Value, name: str) -> Value:
        """Return the value of the attribute ``name`` of an inferred value."""
        if value is None or value == NOTHING:
            return None
        kind, detail = value[0], value[1]
        if kind == "message":
            return field_value(detail, name)
        if kind == "package":
            return imported_value(detail, name)
        if kind == "class":
            part = f"{detail}_{name}"
            return ("class", part) if definition(part) else None
        if kind == "goal":
            return instance(detail + "_Goal") if name == "request" else None
        if kind == "own":
            return self._memoized((detail, name), lambda: self._instance_attribute(detail, name))
        return None

    def _instance_attribute(self, owner: ast.ClassDef, name: str) -> Value:
        """Return the value of an attribute of an instance of the program's class ``owner``."""
        family = self.family(owner)
        if self.dynamic_setattr:
            return None
        values: list[Value] = []
        for node, binding in self.stores[name]:
            receiver = self.infer(node.value)
            if receiver is None or receiver == NOTHING:
                return None
            if receiver[0] in ("own", "own class") and receiver[1] in family:
                values.append(binding())
        for relative in family:
            values += [binding() for binding in self.inner_scopes[relative].names.get(name, [])]
        return join(values) if values else None

    def family(self, owner: ast.ClassDef) -> list[ast.ClassDef]:
        """Return a class, its bases and subclasses, and theirs in turn.

        Classes are compared by name, so the list may contain unrelated ones with the same name.
        """
        family = [owner]
        for member in family:
            bases = {last(base) for base in member.bases}
            for candidates in self.classes.values():
                for candidate in candidates:
                    related = candidate.name in bases or member.name in map(last, candidate.bases)
                    if related and candidate not in family:
                        family.append(candidate)
        return family

    def call(self, node: ast.Call) -> Value:
        """Return the value of a call."""
        function = self.infer(node.func)
        if function is not None:
            if function[0] == "class":
                return instance(function[1])
            if function[0] == "own class":
                return ("own", function[1])
            if function[0] == "function":
                return self.return_value(function[1])
        if not isinstance(node.func, ast.Attribute):
            return None
        method_name, args = node.func.attr, node.args
        if method_name == "create_client":
            # Constant(0), whose value is unknown, replaces an argument that the call lacks.
            service_type = self.infer(argument(node, 0, "srv_type") or ast.Constant(0))
            is_class = service_type is not None and service_type[0] == "class"
            return ("client", service_type[1]) if service_type and is_class else None
        receiver = self.infer(node.func.value)
        if receiver and receiver[0] == "client" and method_name == "call_async":
            return ("future", receiver[1] + "_Response")
        if receiver and receiver[0] == "future" and method_name == "result" and not args:
            return instance(receiver[1])
        return None

    def return_value(self, node: Function) -> Value:
        """Return the value of a call of a function of the program."""
        scope = self.inner_scopes[node]
        if isinstance(node, ast.Lambda):
            return self.infer(node.body)
        if not scope.is_plain or node.decorator_list or not scope.returns:
            return None
        return self._memoized(
            (scope, "return"), lambda: join([self.infer(returned) for returned in scope.returns])
        )

    # --- parameters ---------------------------------------------------------------------------

    def parameter(self, function: Function, at: int, arg: ast.arg) -> Value:
        """Return the value of parameter ``arg`` at position ``at``, by annotation or arguments."""
        if arg.annotation is not None:
            annotation = _plain(arg.annotation)
            if last(annotation) not in _UNTYPED:
                return self.annotated_value(annotation, function)
        owner = self._owner(function)
        if isinstance(function, ast.Lambda):
            return self._argument_value(function, at, arg, 0)
        decorators = {last(decorator) for decorator in function.decorator_list}
        if owner is not None and at == 0 and "staticmethod" not in decorators:
            return ("own class" if "classmethod" in decorators else "own", owner)
        if decorators - {"staticmethod", "classmethod"} or function.name in self.dynamic_names:
            return None
        skip = 1 if owner is not None and "staticmethod" not in decorators else 0
        values = [
            self._argument_value(reference, at, arg, skip)
            for reference in self.references[function.name]
        ]
        return join(values) if values else None

    def annotated_value(self, annotation: ast.expr, at: ast.AST) -> Value:
        """Return the value that an annotation declares, in the scope of the node ``at``."""
        for node in walk(annotation):
            self.scopes.setdefault(node, self.scopes[at])
        value = self.infer(annotation)
        if value is None or value == NOTHING:
            return None
        if value[0] == "class":
            return instance(value[1])
        return ("own", value[1]) if value[0] == "own class" else None

    def _owner(self, function: ast.AST) -> ast.ClassDef | None:
        parent = self.parents.get(function)
        return parent if isinstance(parent, ast.ClassDef) else None

    def _argument_value(self, reference: ast.AST, at: int, arg: ast.arg, skip: int) -> Value:
        """Return the value that one use of a function gives to its parameter ``arg``.

        Args:
            reference: The use: the name of the function, or a lambda itself. The value is known
                only if this is called, or passed to a call that registers callbacks.
            at: Position of the parameter.
            arg: The parameter.
            skip: Number of first parameters that a call does not list: 1 for ``self``, else 0.
        """
        parent = self.parents.get(reference)
        call = parent
        name = ""
        if isinstance(parent, ast.keyword):
            name, call = parent.arg or "", self.parents.get(parent)
        if not isinstance(call, ast.Call):
            return None
        if call.func is reference:
            if any(isinstance(given, ast.Starred) for given in call.args):
                return None
            value = argument(call, at - skip, arg.arg)
            return self.infer(value) if value is not None else None
        position = call.args.index(reference) if reference in call.args else -1
        return self._callback_argument(call, position, name, at - skip)

    def _callback_argument(self, call: ast.Call, position: int, name: str, at: int) -> Value:
        """Return the value of parameter number ``at`` of a callback that is passed to ``call``.

        The callback is the call's positional argument ``position``, or its keyword argument
        ``name``.
        """
        function_name = last(call.func)
        if function_name == "add_done_callback" and isinstance(call.func, ast.Attribute):
            future = self.infer(call.func.value)
            return future if future and future[0] == "future" else None
        if function_name not in _REGISTER:
            return None
        type_at, type_name, callback_at, callback_name, kinds = _REGISTER[function_name]
        if (position != callback_at and name != callback_name) or at >= len(kinds):
            return None
        # Constant(0), whose value is unknown, replaces an argument that the call lacks.
        type_ = self.infer(argument(call, type_at, type_name) or ast.Constant(0))
        if not type_ or type_[0] != "class":
            return None
        if kinds[at] == "goal":
            return ("goal", type_[1])
        suffix = "" if kinds[at] == "message" else "_" + kinds[at].capitalize()
        return instance(type_[1] + suffix)


class _Collector(ast.NodeVisitor):
    """Collects the scopes of a module, and the bindings of each name and attribute."""

    def __init__(self, program: Program, module: Module) -> None:
        self.program = program
        self.module = module
        self.scope = _Scope(module, module.tree, None)
        program.tops[module.name] = self.scope
        for outer in walk(module.tree):
            for inner in ast.iter_child_nodes(outer):
                program.parents[inner] = outer
        self.visit(module.tree)

    def visit(self, node: ast.AST) -> None:
        self.program.scopes[node] = self.scope
        super().visit(node)

    def open(self, node: ast.AST) -> _Scope:
        scope = _Scope(self.module, node, self.scope)
        self.program.inner_scopes[node] = scope
        return scope

    def bind(self, name: str, binding: Binding) -> None:
        scope: _Scope | None = self.scope
        while isinstance(scope.node if scope else None, _COMPREHENSIONS):
            assert scope is not None
            if name in scope.names:
                break
            scope = scope.parent
        assert scope is not None
        if name in scope.outer:
            top = scope.top
            binding_scope = top if scope.outer[name] else scope.binding_scope(name) or top
            binding_scope.names[name].append(binding)
        else:
            scope.names[name].append(binding)

    # Scopes

    def visit_ClassDef(self, node: ast.ClassDef) -> None:
        self.program.classes[node.name].append(node)
        value: Value = ("own class", node) if not node.decorator_list else None
        self.bind(node.name, lambda: value)
        for part in (*node.bases, *node.keywords, *node.decorator_list):
            self.visit(part)
        self._visit_in(self.open(node), node.body)

    def visit_FunctionDef(self, node: ast.FunctionDef | ast.AsyncFunctionDef) -> None:
        self.bind(node.name, lambda: ("function", node))
        for part in (*node.decorator_list, *_defaults(node.args), *filter(None, (node.returns,))):
            self.visit(part)
        self._function(node, node.body)

    visit_AsyncFunctionDef = visit_FunctionDef

    def visit_Lambda(self, node: ast.Lambda) -> None:
        for part in _defaults(node.args):
            self.visit(part)
        self._function(node, [node.body])

    def _function(self, node: Function, body: Iterable[ast.AST]) -> None:
        scope = self.open(node)
        args = node.args
        program = self.program
        for arg in walk(args):
            if isinstance(arg, ast.arg) and arg.annotation is not None:
                self.visit(arg.annotation)
        for at, arg in enumerate((*args.posonlyargs, *args.args)):
            scope.names[arg.arg].append(_parameter(program, node, at, arg))
        for at, arg in enumerate(args.kwonlyargs):
            # A keyword-only parameter has no position; 1000 is beyond the arguments of any call.
            scope.names[arg.arg].append(_parameter(program, node, 1000 + at, arg))
        for rest in filter(None, (args.vararg, args.kwarg)):
            scope.names[rest.arg].append(_unknown)
        for inner in _same_scope(body):
            if isinstance(inner, (ast.Global, ast.Nonlocal)):
                for name in inner.names:
                    scope.outer[name] = isinstance(inner, ast.Global)
            elif isinstance(inner, (ast.Yield, ast.YieldFrom)):
                scope.is_plain = False
            elif isinstance(inner, ast.Return):
                scope.returns.append(inner.value or ast.Constant(None))
        self._visit_in(scope, body)

    def _comprehension(self, node: Any) -> None:
        scope = self.open(node)
        before, self.scope = self.scope, scope
        for generator in node.generators:
            for name in _names(generator.target):
                scope.names[name]  # the defaultdict adds the name, so that bind() finds it here
            self._target(generator.target, _element_of(self.program, generator.iter))
        self.scope = before
        self._visit_in(scope, list(ast.iter_child_nodes(node)))

    visit_ListComp = visit_SetComp = visit_GeneratorExp = visit_DictComp = _comprehension

    def _visit_in(self, scope: _Scope, body: Iterable[ast.AST]) -> None:
        before, self.scope = self.scope, scope
        for statement in body:
            self.visit(statement)
        self.scope = before

    # Bindings

    def _target(self, target: ast.expr, binding: Binding) -> None:
        if isinstance(target, ast.Name):
            self.bind(target.id, binding)
        elif isinstance(target, ast.Attribute):
            self.program.stores[target.attr].append((target, binding))
        elif isinstance(target, (ast.Tuple, ast.List)):
            for element in target.elts:
                self._target(element, _unknown)
        elif isinstance(target, ast.Starred):
            self._target(target.value, _unknown)

    def _assign(self, target: ast.expr, value: ast.expr) -> None:
        targets = target.elts if isinstance(target, ast.Tuple) else []
        values = value.elts if isinstance(value, ast.Tuple) else []
        if targets and len(targets) == len(values):
            for element, element_value in zip(targets, values, strict=True):
                self._assign(element, element_value)
        else:
            self._target(target, lambda: self.program.infer(value))

    def visit_Assign(self, node: ast.Assign) -> None:
        for target in node.targets:
            self._assign(target, node.value)
        self.generic_visit(node)

    def visit_AnnAssign(self, node: ast.AnnAssign) -> None:
        if node.value is not None:
            self._assign(node.target, node.value)
        elif not isinstance(node.target, ast.Name):
            pass
        else:
            annotation = _plain(node.annotation)
            self.bind(node.target.id, lambda: self.program.annotated_value(annotation, node))
        self.generic_visit(node)

    def visit_AugAssign(self, node: ast.AugAssign) -> None:
        self._target(node.target, _unknown)
        self.generic_visit(node)

    def visit_NamedExpr(self, node: ast.NamedExpr) -> None:
        self._assign(node.target, node.value)
        self.generic_visit(node)

    def visit_For(self, node: ast.For | ast.AsyncFor) -> None:
        self._target(node.target, _element_of(self.program, node.iter))
        self.generic_visit(node)

    visit_AsyncFor = visit_For

    def visit_With(self, node: ast.With | ast.AsyncWith) -> None:
        for item in node.items:
            if item.optional_vars is not None:
                self._target(item.optional_vars, _unknown)
        self.generic_visit(node)

    visit_AsyncWith = visit_With

    def visit_ExceptHandler(self, node: ast.ExceptHandler) -> None:
        if node.name:
            self.bind(node.name, _unknown)
        self.generic_visit(node)

    def visit_Import(self, node: ast.Import) -> None:
        for alias in node.names:
            full = alias.name if alias.asname else alias.name.partition(".")[0]
            value = package(full)
            self.bind(alias.asname or full, lambda value=value: value)  # type: ignore[misc]

    def visit_ImportFrom(self, node: ast.ImportFrom) -> None:
        module = absolute(node, self.module)
        for alias in node.names:
            self.bind(alias.asname or alias.name, _imported(self.program, module, alias.name))
            if alias.asname:
                # Calls by the alias are not found. The import counts as a use that is no call, so
                # that the parameters of the function are unknown.
                self.program.references[alias.name].append(alias)

    # References

    def visit_Name(self, node: ast.Name) -> None:
        if isinstance(node.ctx, ast.Load):
            self.program.references[node.id].append(node)
        elif isinstance(node.ctx, ast.Del):
            self.bind(node.id, _unknown)

    def visit_Attribute(self, node: ast.Attribute) -> None:
        self.program.references[node.attr].append(node)
        self.generic_visit(node)

    def visit_Call(self, node: ast.Call) -> None:
        if last(node.func) in ("hasattr", "getattr", "setattr", "delattr") and len(node.args) > 1:
            name = node.args[1]
            if isinstance(name, ast.Constant):
                self.program.dynamic_names.add(str(name.value))
            elif last(node.func) == "setattr":
                self.program.dynamic_setattr = True
        self.generic_visit(node)


_COMPREHENSIONS: Final = (ast.ListComp, ast.SetComp, ast.GeneratorExp, ast.DictComp)


def _unknown() -> Value:
    return None


def _parameter(program: Program, node: Function, at: int, arg: ast.arg) -> Binding:
    return lambda: program.parameter(node, at, arg)


def _element_of(program: Program, node: ast.expr) -> Binding:
    return lambda: element_of(program.infer(node))


def _imported(program: Program, module: str, name: str) -> Binding:
    def find() -> Value:
        top = program.tops.get(module)
        if top is not None:
            return program.name(name, top)
        return imported_value(module, name)

    return find


def _plain(annotation: ast.expr) -> ast.expr:
    """Return ``X`` for an annotation ``"X"``, ``Optional[X]`` or ``X | None``."""
    if isinstance(annotation, ast.Constant) and isinstance(annotation.value, str):
        try:
            annotation = ast.parse(annotation.value, mode="eval").body
        except SyntaxError:
            return annotation
    if isinstance(annotation, ast.BinOp):
        sides = [annotation.left, annotation.right]
        types = [
            side for side in sides if not (isinstance(side, ast.Constant) and side.value is None)
        ]
        return types[0] if len(types) == 1 else annotation
    if isinstance(annotation, ast.Subscript) and last(annotation.value) == "Optional":
        return annotation.slice
    return annotation


def last(node: ast.AST | None) -> str:
    """Return the last part of a dotted name."""
    if isinstance(node, ast.Attribute):
        return node.attr
    return node.id if isinstance(node, ast.Name) else ""


def argument(call: ast.Call, at: int, name: str) -> ast.expr | None:
    """Return the argument of a call by position or keyword; None if the call lacks it."""
    if 0 <= at < len(call.args):
        return call.args[at]
    return next((keyword.value for keyword in call.keywords if keyword.arg == name), None)


def _defaults(args: ast.arguments) -> list[ast.expr]:
    return [*args.defaults, *(default for default in args.kw_defaults if default is not None)]


def _names(target: ast.AST) -> list[str]:
    return [node.id for node in walk(target) if isinstance(node, ast.Name)]


def _same_scope(body: Iterable[ast.AST]) -> Iterator[ast.AST]:
    """Yield all nodes of a body, except those within nested functions and classes."""
    for node in body:
        yield node
        if not isinstance(node, (*FUNCTIONS, ast.Lambda, ast.ClassDef)):
            yield from _same_scope(ast.iter_child_nodes(node))
