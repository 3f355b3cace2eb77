"""Tells how a board or the agent is, as a diagnostic status, from its entry in a snapshot."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from ...printable import printable
from .diagnostic_array import ERROR, OK, STALE, WARN, Status

# A board that does not answer is an error from this silence on, and a warning before; in seconds.
SILENT_SECONDS: Final = 10.0
# Slower acknowledgements are a warning, in seconds. A heartbeat asks for one each 0.2 s.
SLOW_SECONDS: Final = 1.0
# A larger offset of a board's clock is a warning, in seconds: much of it may be the line's delay.
CLOCK_SECONDS: Final = 0.5
# A board's time before 2001 counts from its start: its clock was never set.
_NEVER_SET: Final = 1_000_000_000
# So many lost or resent messages, and such a part of all, are a warning; single ones are usual.
_MANY: Final = 5
_LOST_PART: Final = 0.05
_RESENT_PART: Final = 0.1
# A refused client is told for so long, in seconds.
REFUSED_SECONDS: Final = 60.0
# The most nodes of a board and transports of the agent that are listed.
_MAX_LISTED: Final = 8

_Fault = tuple[int, str]


def board_status(name: str, entry: Mapping[str, Any], wall_clock: float) -> Status:
    """Return the status of a board.

    Args:
        name: The name of the status.
        entry: The board's entry, see :func:`.snapshot.board`.
        wall_clock: The agent's time in seconds since 1970.
    """
    faults = _reachability(entry) or _acknowledgements(entry)
    if refused := entry["refused_objects"]:
        key, why = next(iter(refused.items()))
        more = f" and {len(refused) - 1} more" if len(refused) > 1 else ""
        faults.append((ERROR, f"object {key}{more} refused: {printable(why)}"))
    faults += _losses(entry["recent"], entry["rate_over"])
    faults += _clock(entry["clock_offset"], wall_clock)
    level, message = _judgement(faults, "connected")
    return Status(level, name, message, entry["key"], _board_values(entry))


def left_status(name: str, key: str, seconds: float, last: str) -> Status:
    """Return the status of a board that has left.

    Args:
        name: The name of the status.
        key: The client key.
        seconds: How long ago it left.
        last: The message of its last status.
    """
    return Status(STALE, name, f"disconnected {seconds:.0f} s ago, before: {last}", key, [])


def agent_status(
    name: str,
    host: str,
    head: Mapping[str, Any],
    refused: list[dict[str, Any]],
    boards: int,
    levels: Mapping[int, int],
    held: int,
) -> Status:
    """Return the status of the agent.

    Args:
        name: The name of the status.
        host: The name of this machine.
        head: Its state, see :func:`.snapshot.head`.
        refused: The clients that it refused.
        boards: How many boards are connected.
        levels: How many of them have each level.
        held: Bytes that it holds for them.
    """
    lately = [refusal for refusal in refused if refusal["ago"] < REFUSED_SECONDS]
    faults = []
    if head["memory_full"]:
        faults.append((ERROR, "the memory for boards is used up (see --max-memory)"))
    if boards >= head["max_clients"]:
        faults.append((WARN, "no places left for boards (see --max-clients)"))
    if lately:
        last = lately[-1]
        more = f" and {len(lately) - 1} more" if len(lately) > 1 else ""
        faults.append((WARN, f"refused {last['key']}{more}: {last['why']}, {last['address']}"))
    level, message = _judgement(faults, f"{boards} board{'s' * (boards != 1)}")
    values = [
        ("boards", str(boards)),
        ("boards at most", str(head["max_clients"])),
        ("boards with warnings", str(levels.get(WARN, 0))),
        ("boards with errors", str(levels.get(ERROR, 0))),
        ("boards refused in the last minute", str(len(lately))),
        ("memory held for boards (bytes)", str(held)),
        ("memory for boards at most (bytes)", str(head["limits"]["memory"])),
        ("middleware", head["middleware"]),
        ("pid", str(head["pid"])),
        ("up for (s)", f"{head['uptime']:.0f}"),
        ("CPU used (s)", f"{head['cpu']:.1f}"),
        ("resident memory (bytes)", _known(head["rss"])),
        ("open descriptors", _known(head["fds"])),
    ]
    for transport in head["transports"][:_MAX_LISTED]:
        counters = ", ".join(
            f"{number} {counter.replace('_', ' ')}"
            for counter, number in transport.items()
            if counter == "messages" or (isinstance(number, int) and number)
        )
        values.append((f"{transport['name']} {printable(transport['label'])}".strip(), counters))
    return Status(level, name, message, host, values)


def _judgement(faults: list[_Fault], healthy: str) -> tuple[int, str]:
    """Return the level and the message, the worst fault first."""
    if not faults:
        return OK, healthy
    faults.sort(key=lambda fault: -fault[0])
    return faults[0][0], "; ".join(text for _, text in faults)


def _reachability(entry: Mapping[str, Any]) -> list[_Fault]:
    silence = entry["heard_ago"]
    if entry["line_lost"]:
        return [(ERROR, f"the line is lost, last message {silence:.0f} s ago")]
    if entry["unanswered"]:
        level = WARN if silence < SILENT_SECONDS else ERROR
        return [(level, f"silent for {silence:.0f} s, no answer to a ping")]
    return []


def _acknowledgements(entry: Mapping[str, Any]) -> list[_Fault]:
    slowest = max(entry["round_trip"] or 0.0, entry["unacknowledged_for"])
    if slowest < SLOW_SECONDS:
        return []
    return [(WARN, f"slow acknowledgements: after {slowest:.1f} s")]


def _losses(recent: Mapping[str, int], seconds: float) -> list[_Fault]:
    lately = f"in the last {seconds:.0f} s"
    faults = []
    if count := recent["dropped"] + recent["given_up"]:
        faults.append((WARN, f"{count} message{'s' * (count != 1)} dropped {lately}"))
    lost, arrived = recent["lost"], recent["received"]
    if lost >= _MANY and lost > _LOST_PART * (lost + arrived):
        faults.append((WARN, f"{lost} of {lost + arrived} messages lost on the way {lately}"))
    resent, sent = recent["resent"], recent["sent"]
    if resent >= _MANY and resent > _RESENT_PART * sent:
        faults.append((WARN, f"{resent} of {sent} messages sent again {lately}"))
    return faults


def _clock(offset: float | None, wall_clock: float) -> list[_Fault]:
    if offset is None or abs(offset) < CLOCK_SECONDS or wall_clock + offset < _NEVER_SET:
        return []
    way = "ahead of" if offset > 0 else "behind"
    return [(WARN, f"clock {abs(offset):.1f} s {way} the agent's")]


def _board_values(entry: Mapping[str, Any]) -> list[tuple[str, str]]:
    received, sent, queues = entry["received"], entry["sent"], entry["queues"]
    nodes = [
        printable(node["name"]) + (f"@{node['domain']}" if node["domain"] else "")
        for node in entry["nodes"][:_MAX_LISTED]
    ]
    round_trip, offset = entry["round_trip"], entry["clock_offset"]
    return [
        ("nodes", " ".join(nodes)),
        ("transport", entry["transport"]),
        ("address", printable(entry["address"])),
        ("connected for (s)", f"{entry['age']:.0f}"),
        ("last message (s ago)", f"{entry['heard_ago']:.1f}"),
        ("messages from the board (1/s)", f"{received['rate']:.1f}"),
        ("messages to the board (1/s)", f"{sent['rate']:.1f}"),
        ("messages from the board", str(received["messages"])),
        ("bytes from the board", str(received["bytes"])),
        ("messages to the board", str(sent["messages"])),
        ("bytes to the board", str(sent["bytes"])),
        ("messages lost", str(received["lost"])),
        ("messages given up", str(received["given_up"])),
        ("messages dropped", str(sent["dropped"])),
        ("messages sent again", str(sent["resent"])),
        ("messages without acknowledgement", str(queues["unacknowledged"])),
        ("messages that wait for the network", str(queues["stalled"])),
        ("round trip (ms)", "unknown" if round_trip is None else f"{round_trip * 1000:.1f}"),
        ("clock offset (s)", "unknown" if offset is None else f"{offset:.3f}"),
        ("refused objects", str(len(entry["refused_objects"]))),
        ("memory in the agent (bytes)", str(entry["held"])),
    ]


def _known(value: int | None) -> str:
    return "unknown" if value is None else str(value)
