"""Type stubs of interface packages, with which an editor knows messages on a board.

On a board, ``from std_msgs.msg import Int32`` imports a module that the builder makes. A stub
``std_msgs/msg/__init__.pyi`` has its fields, constants and constructor.
"""

from __future__ import annotations

import keyword
from collections.abc import Iterable
from pathlib import Path
from typing import Final

from . import registry
from .parse import Action, Field, Message, Service, Type

_PLAIN: Final = {"bool": "bool", "float32": "float", "float64": "float", "string": "str",
                 "wstring": "str"}  # fmt: skip
_HEAD: Final = "from typing import ClassVar, List, Sequence\n"


def write_stubs(folder: Path) -> list[str]:
    """Write the stubs of all known types; return the names of the packages.

    Args:
        folder: The folder of stubs, such as ``typings``; other files in it stay.

    Raises:
        InterfaceError: A definition is wrong.
        OSError: A file cannot be written.
    """
    by_module: dict[tuple[str, str], list[str]] = {}
    for name in registry.list_types():
        package, kind, plain = name.split("/")
        by_module.setdefault((package, kind), []).append(plain)
    for (package, kind), names in by_module.items():
        module = folder / package / kind
        module.mkdir(parents=True, exist_ok=True)
        (folder / package / "__init__.pyi").touch()
        (module / "__init__.pyi").write_text(stub(package, kind, names), encoding="utf-8")
    return sorted({package for package, _ in by_module})


def stub(package: str, kind: str, names: Iterable[str]) -> str:
    """Return the stub of one module, such as ``std_msgs.msg``."""
    lines: list[str] = []
    for name in sorted(names):
        definition = registry.definition(f"{package}/{kind}/{name}")
        lines += [""]
        if isinstance(definition, Message):
            lines += _class(name, definition, "")
            continue
        sections = _sections(definition)
        lines += [f"class {name}:"]
        for section, message in sections.items():
            lines += _class(section, message, "    ")
    text = "\n".join(lines)
    imports = sorted(
        f"import {other.replace('/', '.')}"
        for other in {name.rpartition("/")[0] for name in registry.list_types()}
        if f"{other.replace('/', '.')}." in text
    )
    return "\n".join([_HEAD.rstrip(), *imports, text, ""])


def _sections(definition: Service | Action) -> dict[str, Message]:
    if isinstance(definition, Service):
        return {"Request": definition.request, "Response": definition.response}
    return {"Goal": definition.goal, "Result": definition.result, "Feedback": definition.feedback}


def _class(name: str, message: Message, indent: str) -> list[str]:
    fields = [field for field in message.fields if not keyword.iskeyword(field.name)]
    lines = [f"{indent}class {name}:"]
    for constant in message.constants:
        lines.append(f"{indent}    {constant.name}: ClassVar[{_scalar(constant.type)}]")
    lines += [f"{indent}    {field.name}: {_annotation(field)}" for field in fields]
    arguments = "".join(f", {field.name}: {_annotation(field)} = ..." for field in fields)
    return [*lines, f"{indent}    def __init__(self{arguments}) -> None: ..."]


def _annotation(field: Field) -> str:
    scalar = _scalar(field.type)
    if not field.type.array:
        return scalar
    # Numbers are arrays or bytes when they are received, and any sequence when they are set.
    return f"Sequence[{scalar}]" if scalar in ("int", "float", "bool") else f"List[{scalar}]"


def _scalar(kind: Type) -> str:
    return kind.name.replace("/", ".") if "/" in kind.name else _PLAIN.get(kind.name, "int")
