"""The Python classes of ROS types, from the packages that are installed."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

from ..base import MiddlewareError
from .names import TypeName

# An action is three services and a message under names of its own: where its class has them.
_OF_ACTIONS: Final = {
    "_SendGoal": "SendGoalService",
    "_GetResult": "GetResultService",
    "_FeedbackMessage": "FeedbackMessage",
}


class UnknownType(MiddlewareError):
    """No installed package has the type."""


def find_message(name: TypeName) -> Any:
    """The class of a message, ready for use. Raises UnknownType with a remedy."""
    # Attack: rcl takes the type support of a service for a message's, and crashes.
    return _find(name, ("get_fields_and_field_types", "_CREATE_ROS_MESSAGE"))


def find_service(name: TypeName) -> Any:
    """The class of a service, with ``Request`` and ``Response``, likewise."""
    return _find(name, ("Request", "Response"))


def check_package(name: TypeName) -> None:
    """Raises UnknownType where no package can have the type; imports nothing."""
    if not _has_interfaces(name.package):
        raise UnknownType(
            f"{name}: there is no package {name.package} here; install it"
            f" (ros-<distro>-{name.package.replace('_', '-')}), or source the workspace that has it"
        )


def _find(name: TypeName, marks: tuple[str, ...]) -> Any:
    check_package(name)
    try:
        module = import_module(f"{name.package}.{name.kind}")
        found = _of_action(module, name.name) if name.kind == "action" else None
        found = found or getattr(module, name.name)
        for mark in ("__import_type_support__", *marks):
            if not hasattr(found, mark) and not hasattr(type(found), mark):
                raise AttributeError(mark)
        type(found).__import_type_support__()
        if type(found)._TYPE_SUPPORT is None:
            raise ImportError("its type support does not load")
    except AttributeError:
        raise UnknownType(
            f"{name}: package {name.package} has no such type; is it another version than the"
            " board's?"
        ) from None
    except Exception as error:  # whatever generated code and shared libraries come up with
        raise UnknownType(
            f"{name}: package {name.package} cannot be loaded ({error}); is it built for this"
            " ROS distribution and Python?"
        ) from error
    return found


def _of_action(module: Any, name: str) -> Any:
    for suffix, inner in _OF_ACTIONS.items():
        if name.endswith(suffix):
            return getattr(getattr(module, name.removesuffix(suffix)).Impl, inner)
    return None


def _has_interfaces(package: str) -> bool:
    """Whether a package of that name has been made from ROS interfaces.

    Attack: a board that names any module has the agent import it, and do what it does then. Only
    packages with rosidl's type support beside them are imported.
    """
    try:
        spec = find_spec(package)
    except (ImportError, ValueError):
        return False
    places = spec.submodule_search_locations if spec is not None else None
    return any(
        next(Path(place).glob(f"{package}_s__rosidl_typesupport_*"), None) is not None
        for place in places or ()
    )
