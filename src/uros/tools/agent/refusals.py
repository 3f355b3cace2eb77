"""Says what an agent has refused, which rule did it, how long ago, and what to do about it.

A snapshot counts refusals by kind and rule in ``refusals``, and lists those of boards with a known
client key in ``refused``. An agent of an earlier version has no reasons and no times in
``refusals``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Final

from .quantities import duration

# A refusal that was so long ago, in seconds, is past: boards try again more often than that.
PAST: Final = 300.0
_NETWORKS: Final = "networks of [admission] (--allow-net)"
_REMEDIES: Final = {
    "key_in_use": "another board answers with this key: give each its own (uros: key=,"
    " micro-ROS: rmw_uros_options_set_client_key), or switch that one off",
    "allow_key": "add its key to keys of [admission] (--allow-key), unless the board is not yours",
    "allow_net": f"add its network to {_NETWORKS}, unless the board is not yours",
    "max_clients": "raise max_clients of [admission] (--max-clients), or start another agent",
    "max_memory": "raise max_memory of [limits] (--max-memory), or find the board that uses so much"
    " (uros agent status -v)",
    "protocol": "is this a micro-ROS client of XRCE 1?",
    "connections": "end what opens so many, or let boards use UDP",
}  # fmt: skip


def remedy(rule: str, why: str) -> str:
    """Return what to do about a refusal; "" if its reason says so, or nothing is known.

    Args:
        rule: The rule that refused.
        why: The reason.
    """
    if why.startswith("MTU"):
        return "give its transport a larger MTU"
    if rule == "tls":
        return why.partition(": ")[2]
    return _REMEDIES.get(rule, "")


def reason(refusal: Mapping[str, Any]) -> str:
    """Return why something was refused, without the remedy."""
    why = str(refusal["why"])
    return why.partition(": ")[0] if refusal["rule"] == "tls" else why


def others(snapshot: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield the refusals of a snapshot that are not in its list of refused boards."""
    for refusal in snapshot.get("refusals", ()):
        if refusal.get("kind") in ("connection", "request") and "why" in refusal:
            yield refusal


def is_past(refusal: Mapping[str, Any]) -> bool:
    """Return whether a refusal was so long ago that its cause may be mended."""
    return bool(refusal.get("ago", 0.0) > PAST)


def keeps_boards_out(snapshot: Mapping[str, Any]) -> bool:
    """Return whether the agent has lately refused boards, or connections that may be of boards."""
    refused = list(snapshot.get("refused", ()))
    refused += [each for each in others(snapshot) if each["kind"] == "connection"]
    return any(not is_past(each) for each in refused)


def what_was_refused(refusal: Mapping[str, Any]) -> str:
    """Return who refused how many of what, the latest address, and how long ago that was."""
    times, rule = refusal["times"], refusal["rule"]
    many = "s" * (times != 1)
    if rule == "allow_net":
        text = f"the rule {_NETWORKS} refused {times} message{many} or connection{many}"
    elif refusal["kind"] == "request":
        text = f"the agent refused {times} request{many} of boards ({rule})"
    else:
        who = "TLS" if rule == "tls" else "the limit of connections"
        text = f"{who} refused {times} connection{many}"
    ago = f" {duration(refusal['ago'])} ago" if "ago" in refusal else ""
    if is_past(refusal):
        return f"{text}, but none lately: the latest{ago} from {refusal['address']}"
    return f"{text}, the latest{ago} from {refusal['address']}"
