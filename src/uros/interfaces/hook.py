"""Classes at run time: `load`, and imports from ``uros.interfaces.<package>.<msg|srv|action>``.

Host only. Every type is a module of its own, as on a board, made by the same generator:
``uros.interfaces.std_msgs.msg._int32``.
"""

from __future__ import annotations

import importlib
import sys
from functools import cache
from importlib.abc import Loader
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any, Final

from . import registry
from .errors import InterfaceError
from .generate import generate, module_name

PREFIX: Final = __name__.rpartition(".")[0] + "."


@cache
def load(name: str) -> Any:
    """Return the class of a type, made on first use with its nested types, then cached.

    ``name`` is ``std_msgs/msg/Int32``, ``std_msgs/Int32``, ``std_msgs::msg::dds_::Int32_``, a
    service, an action, or a part of these (``std_srvs/srv/Trigger_Request``,
    ``std_srvs/srv/Trigger_Event``, ``test_msgs/action/Fibonacci_SendGoal``).

    Raises:
        InterfaceError: If the type has no definition, or a broken one.
    """
    definition = registry.definition(registry.normalize(name))
    package, kind, plain = definition.type_name.split("/")
    base = registry.file_type(definition.type_name).rpartition("/")[2]
    if plain.endswith("_Event"):  # few programs need it, so it is in no service's own module
        return getattr(_module_of(definition.type_name), plain)
    module = importlib.import_module(f"{PREFIX}{package}.{kind}.{module_name(base)}")
    try:
        return getattr(module, plain)
    except AttributeError:
        raise InterfaceError(f"{name} and another type differ only in case; rename one") from None


def _module_of(name: str) -> ModuleType:
    """Return the module of a structure that no file defines, such as a service's event."""
    package, kind, plain = name.split("/")
    loader = _Type(name)
    module = ModuleType(f"{PREFIX}{package}.{kind}.{module_name(plain)}")
    module.__loader__ = loader
    loader.exec_module(module)
    return module


def find_spec(fullname: str) -> ModuleSpec | None:
    """Return the import system's spec of a module; None if no known package, kind or type."""
    parts = fullname[len(PREFIX) :].split(".")
    if len(parts) > 3 or not registry.has_package(parts[0]):
        return None
    if len(parts) == 1:
        return ModuleSpec(fullname, _Folder(), is_package=True)
    if parts[1] not in registry.KINDS:
        return None
    if len(parts) == 2:
        return ModuleSpec(fullname, _Names(parts[0], parts[1]), is_package=True)
    for plain in registry.names_in(parts[0], parts[1]):
        if module_name(plain) == parts[2]:
            return ModuleSpec(fullname, _Type("/".join((parts[0], parts[1], plain))))
    return None


class _Folder(Loader):
    """Loader of ``uros.interfaces.<package>``."""

    def create_module(self, spec: ModuleSpec) -> None:
        return None

    def exec_module(self, module: ModuleType) -> None:
        module.__path__ = []


class _Names(_Folder):
    """Loader of ``uros.interfaces.<package>.msg``: its names load their types on first use."""

    def __init__(self, package: str, kind: str) -> None:
        self.package = package
        self.kind = kind

    def exec_module(self, module: ModuleType) -> None:
        super().exec_module(module)
        module.__dict__["__getattr__"] = self._attribute
        module.__dict__["__dir__"] = lambda: registry.names_in(self.package, self.kind)

    def _attribute(self, name: str) -> Any:
        full = f"{self.package}/{self.kind}/{name}"
        if name == "__all__":
            return registry.names_in(self.package, self.kind)
        if not name[:1].isupper() or not registry.exists(full):
            raise AttributeError(f"no type {full!r}; see uros.interfaces.list_types()")
        return load(full)


class _Type(Loader):
    """Loader of one generated module; provides its source to tracebacks."""

    def __init__(self, name: str) -> None:
        self.name = name

    def create_module(self, spec: ModuleSpec) -> None:
        return None

    def get_source(self, fullname: str) -> str:
        return generate(registry.definition(self.name), PREFIX)

    def exec_module(self, module: ModuleType) -> None:
        code = compile(self.get_source(module.__name__), f"<{self.name}>", "exec")
        exec(code, module.__dict__)
        sys.modules[module.__name__] = module
