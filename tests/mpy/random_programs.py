"""Random class programs for test_differential.py; the same seed gives the same program.

The programs use the features that a pass may translate wrongly: inheritance and overriding, class
attributes that depend on others or are bound two at a time, helpers called once (in loops, in
conditions, in a try), locals that are bound on some paths only, globals that a callee changes,
properties, default and star arguments, closures, exceptions, and modules that import each other. A
program prints its results as a list. Errors appear by their class alone, since their texts contain
names.
"""

from __future__ import annotations

from random import Random

ERRORS = "(NameError, AttributeError, TypeError, ValueError, IndexError, ZeroDivisionError)"


class Program:
    """One program of two modules.

    Its names end with its number, so that programs in one bundle share no names.
    """

    def __init__(self, number: int) -> None:
        self.random = Random(number)
        self.number = number
        self.lines: list[str] = []
        self.depth = 0
        self.helpers: list[str] = []
        self.calls: list[str] = []  # methods that call helpers

    # Text

    def put(self, line: str) -> None:
        self.lines.append("    " * self.depth + line)

    def name(self, word: str) -> str:
        return f"{word}_{self.number}"

    def chance(self, share: float) -> bool:
        return self.random.random() < share

    def modules(self, first: str, second: str) -> dict[str, str]:
        """Return the texts of two modules with these names; the second has ``run_N``."""
        first_text = self.first()
        self.lines = []
        self.depth = 0
        self.second(first)
        return {first.rpartition(".")[2]: first_text, second: "\n".join(self.lines) + "\n"}

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
        self.put("def __init__(self, results):")
        self.put("    self.results = results")
        self.put(f"    self.{n('total')} = self.{attributes[0]}")
        methods = [n("look"), n("weigh")]
        for method in methods:
            self.method(method, attributes, over=False)
        if self.chance(0.5):
            self.property(attributes)
        self.family(attributes, has_helpers=self.chance(0.4))
        self.depth -= 1
        if self.chance(0.9):
            self.put(f"class {n('Subclass')}({n('Base')}):")
            self.depth += 1
            overridden = [attribute for attribute in attributes if self.chance(0.5)]
            self.attributes(overridden or attributes[:1])
            if self.chance(0.4):
                self.put("def __init__(self, results):")
                self.put("    super().__init__(results)")
                self.put(f"    self.{n('total')} += {self.random.randrange(9)}")
            for method in methods:
                if self.chance(0.5):
                    self.method(method, attributes, over=True)
            self.family(attributes, has_helpers=True)
            self.depth -= 1
        else:
            self.put(f"{n('Subclass')} = {n('Base')}")
        return "\n".join(self.lines) + "\n"

    def attributes(self, names: list[str]) -> None:
        remaining = list(names)
        while remaining:
            name = remaining.pop(0)
            kind = self.random.randrange(6)
            value = self.random.randrange(1, 9)
            if kind == 0 and remaining:
                self.put(f"{name} = {remaining.pop(0)} = {value}")
            elif kind == 1 and remaining:
                self.put(f"{name}, {remaining.pop(0)} = {value}, {value + 1}")
            elif kind == 2 and remaining:
                second = remaining.pop(0)
                self.put(f"{name} = {value}")
                self.put(f"{second} = {name} * 2")
            elif kind == 3:
                self.put(f"{name} = {self.name('LIMIT')}")
            else:
                self.put(f"{name} = {value}")

    def method(self, name: str, attributes: list[str], over: bool) -> None:
        self.put(f"def {name}(self, x, y={self.random.randrange(5)}):")
        super_call = f"super().{name}(x, y) + " if over and self.chance(0.6) else ""
        self.put(f"    return ({super_call}x + y * self.{self.random.choice(attributes)}) % 97")

    def property(self, attributes: list[str]) -> None:
        n = self.name
        self.put("@property")
        self.put(f"def {n('level')}(self):")
        self.put(f"    return self.{n('total')} + self.{attributes[-1]}")
        self.put(f"@{n('level')}.setter")
        self.put(f"def {n('level')}(self, level):")
        self.put(f"    self.{n('total')} = level + 1")

    def family(self, attributes: list[str], has_helpers: bool) -> None:
        """Write helpers that are called once, and their callers."""
        if not has_helpers:
            return
        n = self.name
        first_number = len(self.helpers)
        count = self.random.randrange(1, 4)
        helpers = [n(f"step{first_number + i}") for i in range(count)]
        self.helpers += helpers
        # Helpers call the helpers behind them.
        uncalled = list(helpers)
        caller = n("go") if first_number == 0 else n(f"go{first_number}")
        self.calls.append(caller)
        self.put(f"def {caller}(self, a, b):")
        self.body(["a", "b"], attributes, uncalled, 3)
        for helper in helpers:
            self.put(f"def {helper}(self, p):")
            self.body(["p"], attributes, [], 2, returns=True)

    # Statements

    def body(
        self, known: list[str], attributes: list[str], uncalled: list[str], size: int,
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
            self.put("self.results.append(u)")
        for _ in range(self.random.randrange(1, size + 2)):
            self.statement(names, attributes, uncalled, returns, 2)
        while uncalled:
            self.call(uncalled.pop(0), names, attributes)
        if self.chance(0.5):
            self.put(f"self.results.append({self.expression(names, attributes)})")
        else:
            self.put(f"self.results.append({self.random.choice(names)})")
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
            lines = ["try:", *("    " + line for line in lines), f"except {ERRORS} as error:"]
            lines.append("    self.results.append(type(error) is NameError)")
            if kind >= 3:
                lines = ["for i in range(3):", *("    " + line for line in lines)]
        for line in lines:
            self.put(line)

    def statement(
        self,
        names: list[str],
        attributes: list[str],
        uncalled: list[str],
        returns: bool,
        depth_left: int,
    ) -> None:
        n, kind = self.name, self.random.randrange(13)
        value = self.expression(names, attributes)
        if kind <= 1:
            self.put(f"{self.random.choice(names)} = {value}")
        elif kind == 2 and uncalled:
            self.call(uncalled.pop(0), names, attributes)
        elif kind == 3:
            self.put(f"{n('more')}({self.random.choice(['', '2', 'by=3'])})")
        elif kind == 4:
            self.put(f"self.{n('total')} += {value}")
        elif kind == 5 and returns:
            self.put(f"if {value} % 3 == 0:")
            self.put("    return")
        elif kind == 6 and depth_left:
            self.put(f"for i in range({self.random.randrange(3)}):")
            self.inside(names, attributes, depth_left)
        elif kind in (7, 8) and depth_left:
            self.put(f"if {value} % 2:")
            self.inside(names, attributes, depth_left)
            if self.chance(0.4):
                self.put("else:")
                self.inside(names, attributes, depth_left)
        elif kind == 9 and depth_left:
            self.put("try:")
            self.inside(names, attributes, depth_left)
            self.put(f"except {ERRORS} as error:")
            self.put("    self.results.append(type(error) is NameError)")
        elif kind == 10 and self.chance(0.2):
            self.put(f"self.results.append([u + {value} for u in range(2)])")
        elif kind == 11:
            self.put(f"if {value} % 5 == 0:")
            self.put(f"    raise {n('Fault')}({value})")
        else:
            self.put(f"self.results.append(({value}, {n('count')}))")

    def inside(self, names: list[str], attributes: list[str], depth_left: int) -> None:
        self.depth += 1
        for _ in range(self.random.randrange(1, 3)):
            self.statement(names, attributes, [], False, depth_left - 1)
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

    # The second module: it imports names of the first, derives a class, and runs the program

    def second(self, first: str) -> None:
        n = self.name
        words = ["Subclass", "more", "counted"]
        if self.chance(0.3):
            self.put(f"from {first} import {n('Base')}")
        is_late = self.chance(0.3)
        if not is_late:
            self.put(f"from {first} import {', '.join(map(n, words))}")
        class_name = n("Subclass")
        if not is_late and self.chance(0.3):
            class_name = n("Own")
            self.put(f"class {class_name}({n('Subclass')}):")
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
        if is_late:
            self.put(f"from {first} import {', '.join(map(n, words))}")
        self.put("results = []")
        self.put("try:")
        self.depth += 1
        self.put(f"instance = {class_name}(results)")
        for caller in self.calls:
            for _ in range(self.random.randrange(1, 3)):
                self.put("try:")
                arguments = f"{self.random.randrange(5)}, {self.random.randrange(5)}"
                self.put(f"    instance.{caller}({arguments})")
                self.put(f"except {ERRORS} as error:")
                self.put("    results.append(isinstance(error, ValueError))")
        self.put(f"results.append({n('star')}(1, {n('more')}(), base=3, x=1))")
        self.put(f"inner = {n('closed')}({n('counted')}())")
        self.put("results.append((inner(1), inner(2)))")
        self.put(
            f"results.append((instance.{n('look')}(1), instance.{n('total')}, {n('counted')}()))"
        )
        self.depth -= 1
        self.put(f"except {ERRORS} as error:")
        self.put("    results.append(type(error) is NameError)")
        self.put("print(results)")
        self.depth -= 1
