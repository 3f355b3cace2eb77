"""Triggers of rclc, for ``executor.trigger``: they decide when a round begins.

A program's own trigger is any function of ``(handles, ready)``, two lists of the same length in the
order in which the handles were added: ``node.executor.trigger = lambda handles, ready: ready[0]``.
What is ready while the trigger returns False is kept; samples are kept as far as their depth
allows.
"""

try:
    from typing import Any, Callable
except ImportError:  # MicroPython
    pass


def trigger_any(handles: "list[Any]", ready: "list[bool]") -> bool:
    """Begin when one handle is ready, as an executor without a trigger does."""
    return True in ready


def trigger_all(handles: "list[Any]", ready: "list[bool]") -> bool:
    """Begin when every handle is ready, timers included."""
    return False not in ready


def trigger_always(handles: "list[Any]", ready: "list[bool]") -> bool:
    """Begin every round; handles with ALWAYS are called even if they are not ready.

    A round takes place when something is ready, and whenever a spin's time is up.
    """
    return True


def trigger_one(handle: "Any") -> "Callable[[list[Any], list[bool]], bool]":
    """Begin when ``handle`` (a subscription, a timer ...) is ready."""

    def trigger(handles: "list[Any]", ready: "list[bool]") -> bool:
        return handle in handles and ready[handles.index(handle)]

    return trigger
