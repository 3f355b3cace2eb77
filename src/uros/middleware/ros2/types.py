"""The Python classes of ROS types, from the installed packages."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

from ..base import MiddlewareError
from ..ros_names import TypeName

# An action's services and feedback message have types of their own, which are attributes of its
# class.
_OF_ACTIONS: Final = {
    "_SendGoal": "SendGoalService",
    "_GetResult": "GetResultService",
    "_FeedbackMessage": "FeedbackMessage",
}


class UnknownType(MiddlewareError):
    """No installed package has the type."""


def find_message(name: TypeName) -> Any:
    """Return the class of a message, with its type support loaded.

    Raises:
        UnknownType: No installed package has it.
    """
    # Refuses a service's class, because rcl takes its type support for a message's and crashes.
    return _find(name, ("get_fields_and_field_types", "_CREATE_ROS_MESSAGE"))


def find_service(name: TypeName) -> Any:
    """Return the class of a service, with ``Request`` and ``Response``; see `find_message`."""
    return _find(name, ("Request", "Response"))


def check_package(name: TypeName) -> None:
    """Check that a package may have the type, without importing one.

    Raises:
        UnknownType: No package can have it.
    """
    if not _has_interfaces(name.package):
        raise UnknownType(
            f"{name}: there is no package {name.package} here; install it"
            f" (ros-<distro>-{name.package.replace('_', '-')}), or source the workspace that has it"
        )


def _find(name: TypeName, attributes: tuple[str, ...]) -> Any:
    check_package(name)
    try:
        module = import_module(f"{name.package}.{name.kind}")
        type_class = _of_action(module, name.name) if name.kind == "action" else None
        type_class = type_class or getattr(module, name.name)
        for attribute in ("__import_type_support__", *attributes):
            if not hasattr(type_class, attribute) and not hasattr(type(type_class), attribute):
                raise AttributeError(attribute)
        type(type_class).__import_type_support__()
        if type(type_class)._TYPE_SUPPORT is None:
            raise ImportError("its type support does not load")
    except AttributeError:
        raise UnknownType(
            f"{name}: package {name.package} has no such type; is it another version than the"
            " board's?"
        ) from None
    except Exception as error:  # whatever generated code and shared libraries raise
        raise UnknownType(
            f"{name}: package {name.package} cannot be loaded ({error}); is it built for this"
            " ROS distribution and Python?"
        ) from error
    return type_class


def _of_action(module: Any, name: str) -> Any:
    for suffix, inner in _OF_ACTIONS.items():
        if name.endswith(suffix):
            return getattr(getattr(module, name.removesuffix(suffix)).Impl, inner)
    return None


def _has_interfaces(package: str) -> bool:
    """Return whether a package of that name was generated from ROS interfaces.

    Only packages with rosidl's type support beside them are imported. Otherwise a board could make
    the agent import any module, with its side effects.
    """
    try:
        spec = find_spec(package)
    except (ImportError, ValueError):
        return False
    folders = spec.submodule_search_locations if spec is not None else None
    return any(
        next(Path(folder).glob(f"{package}_s__rosidl_typesupport_*"), None) is not None
        for folder in folders or ()
    )
