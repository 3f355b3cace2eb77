"""Evaluates the expression of ``--filter``, a small part of Python, on messages.

Nothing but what is listed here can be written, so an expression reads a message and can do nothing
else, and what it computes is bounded whatever a message holds.
"""

from __future__ import annotations

import ast
import math
import operator
import warnings
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Final

from ..errors import ToolError, UsageError, did_you_mean
from . import plain

# Attack: a message whose values make an expression compute or allocate without end.
_MOST_BITS: Final = 1 << 16  # of a whole number
_MOST_ITEMS: Final = 1_000_000  # of a range
_MOST_SHOWN: Final = 60  # characters of an expression in an error

Scope = dict[str, Any]
Step = Callable[[Scope], Any]


def _power(base: Any, exponent: Any) -> Any:
    if isinstance(base, int) and isinstance(exponent, int):
        if base.bit_length() * abs(exponent) > _MOST_BITS:
            raise ValueError("the result of ** is too large")
    return base**exponent


def _shift(number: Any, places: Any) -> Any:
    if places > _MOST_BITS:
        raise ValueError("the result of << is too large")
    return number << places


def _numbers_only(operate: Callable[[Any, Any], Any], sign: str) -> Callable[[Any, Any], Any]:
    def checked(left: Any, right: Any) -> Any:
        if not isinstance(left, (int, float)) or not isinstance(right, (int, float)):
            raise TypeError(f"{sign} takes numbers")
        return operate(left, right)

    return checked


def _range(*limits: int) -> range:
    numbers = range(*limits)
    if len(numbers) > _MOST_ITEMS:
        raise ValueError(f"a range has at most {_MOST_ITEMS} numbers here")
    return numbers


_BINARY: Final[Mapping[type[ast.operator], Callable[[Any, Any], Any]]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: _numbers_only(operator.mul, "*"),
    ast.Div: operator.truediv,
    ast.FloorDiv: operator.floordiv,
    ast.Mod: _numbers_only(operator.mod, "%"),
    ast.Pow: _power,
    ast.LShift: _shift,
    ast.RShift: operator.rshift,
    ast.BitAnd: operator.and_,
    ast.BitOr: operator.or_,
    ast.BitXor: operator.xor,
}
_UNARY: Final[Mapping[type[ast.unaryop], Callable[[Any], Any]]] = {
    ast.Not: operator.not_,
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
    ast.Invert: operator.invert,
}
_COMPARE: Final[Mapping[type[ast.cmpop], Callable[[Any, Any], bool]]] = {
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.Is: operator.is_,
    ast.IsNot: operator.is_not,
    ast.In: lambda left, right: left in right,
    ast.NotIn: lambda left, right: left not in right,
}
FUNCTIONS: Final[Mapping[str, Callable[..., Any]]] = {
    function.__name__: function
    for function in (
        abs, all, any, bool, chr, divmod, enumerate, float, int, len, list, max, min,
        ord, reversed, round, set, sorted, str, sum, tuple, zip,
        math.ceil, math.floor, math.hypot, math.isfinite, math.isnan, math.sqrt,
    )
} | {"range": _range}  # fmt: skip
METHODS: Final = (
    "count", "endswith", "find", "index", "isalpha", "isdigit", "lower", "split", "startswith",
    "strip", "upper",
)  # fmt: skip
_TEXTS: Final = (str, bytes)


class Expression:
    """A parsed expression about ``m``.

    Args:
        text: The expression.

    Raises:
        UsageError: It is no expression, or uses what is not allowed. Says which part.
    """

    def __init__(self, text: str) -> None:
        shown = text if len(text) <= _MOST_SHOWN else text[:_MOST_SHOWN] + "..."
        self._where = f"--filter {shown!r}"
        try:
            with warnings.catch_warnings():  # of escapes in the text
                warnings.simplefilter("ignore")
                tree = ast.parse(text.strip(), mode="eval")
            self._evaluate = self._step(tree.body, frozenset("m"))
        except SyntaxError as error:
            raise self._error(f"no expression: {error.msg}, at column {error.offset}") from error
        except (ValueError, RecursionError, MemoryError) as error:  # NUL; nested too deep
            raise self._error(str(error)) from error

    def _error(self, why: str) -> UsageError:
        return UsageError(f"{self._where}: {why}")

    def check(self, message_class: Any) -> Callable[[Any], bool]:
        """Check the names of fields against a type.

        Args:
            message_class: The type of the messages.

        Returns:
            What tells whether the expression is true for a message. It raises ToolError where the
            expression fails on the message.

        Raises:
            ToolError: The type has no such field.
        """
        try:
            self._evaluate({"m": message_class()})
        except plain.FieldError as error:
            raise ToolError(f"{self._where}: {error}") from error
        except Exception:  # noqa: S110  a list that is empty here need not be so in a message
            pass
        return self.accepts

    def accepts(self, message: Any) -> bool:
        """Return whether the expression is true for a message, or another value.

        Raises:
            ToolError: The expression fails on it.
        """
        try:
            return bool(self._evaluate({"m": message}))
        except Exception as error:
            kind = "" if isinstance(error, plain.FieldError) else f"{type(error).__name__}: "
            raise ToolError(f"{self._where} fails on a message: {kind}{error}") from error

    # --- from the parsed text to functions ------------------------------------------

    def _step(self, node: ast.AST, known: frozenset[str]) -> Step:
        """Return the function that evaluates a node, in which the names ``known`` have a value."""
        translate = getattr(self, f"_{type(node).__name__.lower()}", None)
        if translate is None:
            raise self._error(f"{_shown(node)} is not allowed")
        step: Step = translate(node, known)
        return step

    def _steps(self, nodes: Iterable[ast.AST], known: frozenset[str]) -> list[Step]:
        return [self._step(node, known) for node in nodes]

    def _constant(self, node: ast.Constant, known: frozenset[str]) -> Step:
        value = node.value
        return lambda scope: value

    def _name(self, node: ast.Name, known: frozenset[str]) -> Step:
        name = node.id
        if name not in known:
            hint = did_you_mean(name, [*known, *FUNCTIONS])
            if name in FUNCTIONS:
                hint = "; a function is called, as in len(m.data)"
            raise self._error(f"there is no {name!r} here, only the message m{hint}")
        return lambda scope: scope[name]

    def _attribute(self, node: ast.Attribute, known: frozenset[str]) -> Step:
        name, inner = node.attr, self._step(node.value, known)
        return lambda scope: plain.field(inner(scope), name)

    def _subscript(self, node: ast.Subscript, known: frozenset[str]) -> Step:
        inner, index = self._step(node.value, known), self._step(node.slice, known)
        return lambda scope: inner(scope)[index(scope)]

    def _slice(self, node: ast.Slice, known: frozenset[str]) -> Step:
        ends = [
            (lambda scope: None) if end is None else self._step(end, known)
            for end in (node.lower, node.upper, node.step)
        ]
        return lambda scope: slice(*[end(scope) for end in ends])

    def _boolop(self, node: ast.BoolOp, known: frozenset[str]) -> Step:
        steps = self._steps(node.values, known)
        ends_at = isinstance(node.op, ast.Or)

        def evaluate(scope: Scope) -> Any:
            value: Any = None
            for step in steps:
                value = step(scope)
                if bool(value) is ends_at:
                    return value
            return value

        return evaluate

    def _unaryop(self, node: ast.UnaryOp, known: frozenset[str]) -> Step:
        operate, inner = _UNARY[type(node.op)], self._step(node.operand, known)
        return lambda scope: operate(inner(scope))

    def _binop(self, node: ast.BinOp, known: frozenset[str]) -> Step:
        operate = _BINARY.get(type(node.op))
        if operate is None:
            raise self._error(f"{_shown(node)} is not allowed")
        left, right = self._step(node.left, known), self._step(node.right, known)
        return lambda scope: operate(left(scope), right(scope))

    def _compare(self, node: ast.Compare, known: frozenset[str]) -> Step:
        first = self._step(node.left, known)
        rest = [
            (_COMPARE[type(op)], self._step(right, known))
            for op, right in zip(node.ops, node.comparators, strict=True)
        ]

        def evaluate(scope: Scope) -> bool:
            left = first(scope)
            for compare, step in rest:
                right = step(scope)
                if not compare(left, right):
                    return False
                left = right
            return True

        return evaluate

    def _ifexp(self, node: ast.IfExp, known: frozenset[str]) -> Step:
        test, yes, no = self._steps((node.test, node.body, node.orelse), known)
        return lambda scope: yes(scope) if test(scope) else no(scope)

    def _list(self, node: ast.List, known: frozenset[str]) -> Step:
        steps = self._steps(node.elts, known)
        return lambda scope: [step(scope) for step in steps]

    def _tuple(self, node: ast.Tuple, known: frozenset[str]) -> Step:
        steps = self._steps(node.elts, known)
        return lambda scope: tuple([step(scope) for step in steps])

    def _set(self, node: ast.Set, known: frozenset[str]) -> Step:
        steps = self._steps(node.elts, known)
        return lambda scope: {step(scope) for step in steps}

    def _call(self, node: ast.Call, known: frozenset[str]) -> Step:
        if node.keywords:
            raise self._error(f"{_shown(node)}: arguments with names are not allowed")
        steps = self._steps(node.args, known)
        if isinstance(node.func, ast.Name) and node.func.id in FUNCTIONS:
            function = FUNCTIONS[node.func.id]
            return lambda scope: function(*[step(scope) for step in steps])
        if isinstance(node.func, ast.Attribute) and node.func.attr in METHODS:
            method, inner = node.func.attr, self._step(node.func.value, known)
            return lambda scope: _call_method(inner(scope), method, [step(scope) for step in steps])
        name = _shown(node.func)
        known_names = METHODS if isinstance(node.func, ast.Attribute) else FUNCTIONS
        last = name.rpartition(".")[2]
        raise self._error(f"there is no function {name}{did_you_mean(last, known_names)}")

    def _listcomp(self, node: ast.ListComp | ast.GeneratorExp, known: frozenset[str]) -> Step:
        (loop, *more) = node.generators
        if more or loop.is_async or not isinstance(loop.target, ast.Name):
            raise self._error(f"{_shown(node)}: give one 'for' with one name")
        name = loop.target.id
        items = self._step(loop.iter, known)
        known |= {name}
        body, conditions = self._step(node.elt, known), self._steps(loop.ifs, known)

        def evaluate(scope: Scope) -> list[Any]:
            values = []
            for value in items(scope):
                inner = {**scope, name: value}
                if all(condition(inner) for condition in conditions):
                    values.append(body(inner))
            return values

        return evaluate

    _generatorexp = _listcomp


def _call_method(value: Any, name: str, arguments: list[Any]) -> Any:
    """Call a method of a text, or ``count`` and ``index`` of a list."""
    if isinstance(value, _TEXTS) or (
        isinstance(value, (list, tuple)) and name in ("count", "index")
    ):
        return getattr(value, name)(*arguments)
    raise TypeError(f"{type(value).__name__} has no {name}()")


def _shown(node: ast.AST) -> str:
    """Return the beginning of a part of an expression as text."""
    text = ast.unparse(node)
    return text if len(text) <= _MOST_SHOWN else text[:_MOST_SHOWN] + "..."
