"""Small class programs at random, for test_differential.py: the same seed is the same program.

They are full of what a rewriting may get wrong: inheritance and overriding, class attributes made
of others or bound two at a time, helpers called once (in loops, in conditions, in a try), locals
that are bound on some paths only, globals that a callee changes, properties, default and star
arguments, closures, exceptions, and modules that import each other. What a program finds is in a
list that it prints. Errors stand there by their class alone: their texts have names in them.
"""

from __future__ import annotations

from random import Random

ERRORS = "(NameError, AttributeError, TypeError, ValueError, IndexError, ZeroDivisionError)"


class Program:
    """One program of two modules. Its names end with its number: in a bundle with others each is
    still alone with them."""

    def __init__(self, number: int) -> None:
        self.random = Random(number)
        self.number = number
        self.lines: list[str] = []
        self.depth = 0
        self.helpers: list[str] = []
        self.calls: list[str] = []  # of helpers, each to be made once

    # Text

    def put(self, line: str) -> None:
        self.lines.append("    " * self.depth + line)

    def name(self, word: str) -> str:
        return f"{word}_{self.number}"

    def chance(self, share: float) -> bool:
        return self.random.random() < share

    def modules(self, first: str, second: str) -> dict[str, str]:
        """The texts of two modules; the second has ``run_N``. They are imported by these names."""
        one = self.first()
        self.lines = []
        self.depth = 0
        self.second(first)
        return {first.rpartition(".")[2]: one, second: "\n".join(self.lines) + "\n"}

    # The first module: a family of classes

    def first(self) -> str:
        n = self.name
        self.put(f"{n('count')} = {self.random.randrange(3)}")
        self.put(f"{n('LIMIT')} = {self.random.randrange(2, 6)}")
        self.put(f"def {n('more')}(by=1):")
        self.put(f"    global {n('count')}")
        self.put(f"    {n('count')} += by")
        self.put(f"    return {n('count')}")
        self.put(f"def {n('counted')}():")
        self.put(f"    return {n('count')}")
        self.put(f"class {n('Fault')}(ValueError):")
        self.put("    pass")
        attributes = [n(f"A{i}") for i in range(self.random.randrange(2, 5))]
        self.put(f"class {n('Base')}:")
        self.depth += 1
        self.attributes(attributes)
        self.put("def __init__(self, told):")
        self.put("    self.told = told")
        self.put(f"    self.{n('total')} = self.{attributes[0]}")
        methods = [n("look"), n("weigh")]
        for method in methods:
            self.method(method, attributes, over=False)
        if self.chance(0.5):
            self.property(attributes)
        self.family(attributes, own=self.chance(0.4))
        self.depth -= 1
        if self.chance(0.9):
            self.put(f"class {n('Heir')}({n('Base')}):")
            self.depth += 1
            over = [it for it in attributes if self.chance(0.5)]
            self.attributes(over or attributes[:1])
            if self.chance(0.4):
                self.put("def __init__(self, told):")
                self.put("    super().__init__(told)")
                self.put(f"    self.{n('total')} += {self.random.randrange(9)}")
            for method in methods:
                if self.chance(0.5):
                    self.method(method, attributes, over=True)
            self.family(attributes, own=True)
            self.depth -= 1
        else:
            self.put(f"{n('Heir')} = {n('Base')}")
        return "\n".join(self.lines) + "\n"

    def attributes(self, names: list[str]) -> None:
        left = list(names)
        while left:
            name = left.pop(0)
            kind = self.random.randrange(6)
            value = self.random.randrange(1, 9)
            if kind == 0 and left:
                self.put(f"{name} = {left.pop(0)} = {value}")
            elif kind == 1 and left:
                self.put(f"{name}, {left.pop(0)} = {value}, {value + 1}")
            elif kind == 2 and left:
                other = left.pop(0)
                self.put(f"{name} = {value}")
                self.put(f"{other} = {name} * 2")
            elif kind == 3:
                self.put(f"{name} = {self.name('LIMIT')}")
            else:
                self.put(f"{name} = {value}")

    def method(self, name: str, attributes: list[str], over: bool) -> None:
        self.put(f"def {name}(self, x, y={self.random.randrange(5)}):")
        above = f"super().{name}(x, y) + " if over and self.chance(0.6) else ""
        self.put(f"    return ({above}x + y * self.{self.random.choice(attributes)}) % 97")

    def property(self, attributes: list[str]) -> None:
        n = self.name
        self.put("@property")
        self.put(f"def {n('level')}(self):")
        self.put(f"    return self.{n('total')} + self.{attributes[-1]}")
        self.put(f"@{n('level')}.setter")
        self.put(f"def {n('level')}(self, level):")
        self.put(f"    self.{n('total')} = level + 1")

    def family(self, attributes: list[str], own: bool) -> None:
        """Helpers that are called once, and what calls them."""
        if not own:
            return
        n = self.name
        where = len(self.helpers)
        count = self.random.randrange(1, 4)
        fresh = [n(f"step{where + i}") for i in range(count)]
        self.helpers += fresh
        # The first few take what comes behind them: calls of calls.
        waiting = list(fresh)
        caller = n("go") if where == 0 else n(f"go{where}")
        self.calls.append(caller)
        self.put(f"def {caller}(self, a, b):")
        self.body(["a", "b"], attributes, waiting, 3)
        for helper in fresh:
            self.put(f"def {helper}(self, p):")
            self.body(["p"], attributes, [], 2, returns=True)

    # Statements

    def body(
        self, known: list[str], attributes: list[str], waiting: list[str], size: int,
        returns: bool = False,
    ) -> None:  # fmt: skip
        self.depth += 1
        n, names = self.name, [*known, "u", "v", "i"]
        for name in names[len(known) :]:
            if self.chance(0.2 if returns else 0.6):
                self.put(f"{name} = {self.random.randrange(9)}")
        if returns and self.chance(0.5):
            self.put(f"if {n('more')}() % 2:")
            self.put(f"    u = {n('count')}")
            self.put("self.told.append(u)")
        for _ in range(self.random.randrange(1, size + 2)):
            self.statement(names, attributes, waiting, returns, 2)
        while waiting:
            self.call(waiting.pop(0), names, attributes)
        if self.chance(0.5):
            self.put(f"self.told.append({self.expression(names, attributes)})")
        else:
            self.put(f"self.told.append({self.random.choice(names)})")
        self.depth -= 1

    def call(self, helper: str, names: list[str], attributes: list[str]) -> None:
        argument = self.random.choice(
            [
                str(self.random.randrange(9)),
                self.random.choice(names),
                self.name("count"),
                self.name("LIMIT"),
                self.expression(names, attributes),
            ]
        )
        kind = self.random.randrange(6)
        lines = [f"self.{helper}({argument})"]
        if kind == 1:
            lines = [f"for i in range({self.random.randrange(2, 4)}):", "    " + lines[0]]
        elif kind == 2:
            lines = [f"if {self.expression(names, attributes)} % 2:", "    " + lines[0]]
        if self.chance(0.6):
            lines = ["try:", *("    " + it for it in lines), f"except {ERRORS} as error:"]
            lines.append("    self.told.append(type(error) is NameError)")
            if kind >= 3:
                lines = ["for i in range(3):", *("    " + it for it in lines)]
        for line in lines:
            self.put(line)

    def statement(
        self, names: list[str], attributes: list[str], waiting: list[str], returns: bool, deep: int
    ) -> None:
        n, kind = self.name, self.random.randrange(13)
        value = self.expression(names, attributes)
        if kind <= 1:
            self.put(f"{self.random.choice(names)} = {value}")
        elif kind == 2 and waiting:
            self.call(waiting.pop(0), names, attributes)
        elif kind == 3:
            self.put(f"{n('more')}({self.random.choice(['', '2', 'by=3'])})")
        elif kind == 4:
            self.put(f"self.{n('total')} += {value}")
        elif kind == 5 and returns:
            self.put(f"if {value} % 3 == 0:")
            self.put("    return")
        elif kind == 6 and deep:
            self.put(f"for i in range({self.random.randrange(3)}):")
            self.inside(names, attributes, deep)
        elif kind in (7, 8) and deep:
            self.put(f"if {value} % 2:")
            self.inside(names, attributes, deep)
            if self.chance(0.4):
                self.put("else:")
                self.inside(names, attributes, deep)
        elif kind == 9 and deep:
            self.put("try:")
            self.inside(names, attributes, deep)
            self.put(f"except {ERRORS} as error:")
            self.put("    self.told.append(type(error) is NameError)")
        elif kind == 10 and self.chance(0.2):
            self.put(f"self.told.append([u + {value} for u in range(2)])")
        elif kind == 11:
            self.put(f"if {value} % 5 == 0:")
            self.put(f"    raise {n('Fault')}({value})")
        else:
            self.put(f"self.told.append(({value}, {n('count')}))")

    def inside(self, names: list[str], attributes: list[str], deep: int) -> None:
        self.depth += 1
        for _ in range(self.random.randrange(1, 3)):
            self.statement(names, attributes, [], False, deep - 1)
        self.depth -= 1

    def expression(self, names: list[str], attributes: list[str]) -> str:
        n = self.name
        simple = [
            str(self.random.randrange(9)),
            self.random.choice(names[:-3]),
            self.random.choice(names),
            f"self.{self.random.choice(attributes)}",
            f"self.{n('total')}",
            n("count"),
            n("LIMIT"),
            f"{n('more')}()",
            f"self.{n('look')}({self.random.randrange(5)})",
            f"self.{n('weigh')}(1, {self.random.randrange(5)})",
        ]
        left, right = self.random.choice(simple), self.random.choice(simple)
        return f"({left} {self.random.choice('+-*')} {right}) % 97" if self.chance(0.6) else left

    # The second module: it takes names from the first, derives, and runs

    def second(self, first: str) -> None:
        n = self.name
        words = ["Heir", "more", "counted"]
        if self.chance(0.3):
            self.put(f"from {first} import {n('Base')}")
        late = self.chance(0.3)
        if not late:
            self.put(f"from {first} import {', '.join(map(n, words))}")
        used = n("Heir")
        if not late and self.chance(0.3):
            used = n("Own")
            self.put(f"class {used}({n('Heir')}):")
            self.put(f"    def {n('look')}(self, x, y=1):")
            self.put(f"        return super().{n('look')}(x, y) + 1")
        self.put(f"def {n('star')}(*args, base=2, **more):")
        self.put("    return sum(args) * base + len(more)")
        self.put(f"def {n('closed')}(n):")
        self.put("    def inner(k):")
        self.put("        nonlocal n")
        self.put("        n += k")
        self.put("        return n")
        self.put("    return inner")
        self.put(f"def {n('run')}():")
        self.depth += 1
        if late:
            self.put(f"from {first} import {', '.join(map(n, words))}")
        self.put("told = []")
        self.put("try:")
        self.depth += 1
        self.put(f"it = {used}(told)")
        for caller in self.calls:
            for _ in range(self.random.randrange(1, 3)):
                self.put("try:")
                arguments = f"{self.random.randrange(5)}, {self.random.randrange(5)}"
                self.put(f"    it.{caller}({arguments})")
                self.put(f"except {ERRORS} as error:")
                self.put("    told.append(isinstance(error, ValueError))")
        self.put(f"told.append({n('star')}(1, {n('more')}(), base=3, x=1))")
        self.put(f"inner = {n('closed')}({n('counted')}())")
        self.put("told.append((inner(1), inner(2)))")
        self.put(f"told.append((it.{n('look')}(1), it.{n('total')}, {n('counted')}()))")
        self.depth -= 1
        self.put(f"except {ERRORS} as error:")
        self.put("    told.append(type(error) is NameError)")
        self.put("print(told)")
        self.depth -= 1
