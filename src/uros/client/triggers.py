"""When an executor's round begins: the triggers of rclc, for ``executor.trigger``.

A program's own is any function of ``(handles, ready)``, two lists of the same length and in the
order in which handles were added: ``node.executor.trigger = lambda handles, ready: ready[0]``.
What is ready while the trigger says no is kept, and so are samples, as far as their depth goes.
"""

try:
    from typing import Any, Callable
except ImportError:  # MicroPython
    pass


def trigger_any(handles: "list[Any]", ready: "list[bool]") -> bool:
    """Begin when one handle is ready: what an executor without a trigger does."""
    return True in ready


def trigger_all(handles: "list[Any]", ready: "list[bool]") -> bool:
    """Begin when every handle is ready, timers too."""
    return False not in ready


def trigger_always(handles: "list[Any]", ready: "list[bool]") -> bool:
    """Begin every round: handles with ALWAYS are called whether there is something new or not.

    A round is made when something is ready, and whenever a spin's time is up.
    """
    return True


def trigger_one(handle: "Any") -> "Callable[[list[Any], list[bool]], bool]":
    """Begin when ``handle`` (a subscription, a timer ...) is ready."""

    def trigger(handles: "list[Any]", ready: "list[bool]") -> bool:
        return handle in handles and ready[handles.index(handle)]

    return trigger
