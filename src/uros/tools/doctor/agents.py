"""The agents on this machine: their ports, and what their snapshots tell of boards."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any, Final

from . import process
from .finding import Finding, note, ok, problem, unknown, word

# A board's clock that is so far off, in seconds, mixes up what is fused by time.
CLOCK_LIMIT: Final = 0.1
# Bytes without a frame that are a fault, and broken frames: how many, and one in how many.
_NOISE: Final = 64
_FEW: Final = 5
_BROKEN: Final = 20
# Ports that are tried for a free one to name.
_TRIES: Final = 64

Snapshot = dict[str, Any]


# --- ports ------------------------------------------------------------------------------------


def check_port(port: int, agents: Collection[int] = (), asked: bool = True) -> list[Finding]:
    """Whether an agent may listen on ``port`` by UDP and TCP; ``agents`` are pids of ours.

    ``asked``: the user has named it. Else TCP matters little: few boards speak it, and the port
    is a favourite.
    """
    if not process.can_look():
        return [unknown("port", "this system has no /proc that tells who uses a port")]
    taken = [process.taken_port(protocol, port) for protocol in ("udp", "tcp")]
    if not any(taken):
        return [ok("port", f"port {port} is free, by UDP and by TCP")]
    return [_taken(it, agents, asked or it.protocol == "udp") for it in taken if it is not None]


def _taken(it: process.Taken, agents: Collection[int], grave: bool) -> Finding:
    where = f"{it.protocol.upper()} port {it.port}"
    other = (
        f"choose another port: uros agent {it.protocol}4 --port {_free(it)}, and tell the boards"
    )
    if not it.holders:
        return (problem if grave else note)(
            "port",
            f"{where} is in use by a process of another user",
            f"see whose: sudo ss -lpn 'sport = :{it.port}'; or {other}",
        )
    names = " and ".join(map(str, it.holders))
    kill = "kill " + " ".join(str(one.pid) for one in it.holders)
    if all(one.pid in agents or one.is_uros_agent for one in it.holders):
        return ok("port", f"{where} is served by an agent of uros: {names}",
                  f"only to start another agent in its place: {kill}")  # fmt: skip
    if any(one.is_foreign_agent for one in it.holders):
        names += ", eProsima's agent"
    return (problem if grave else note)(
        "port", f"{where} is in use by {names}", f"{kill}; or {other}"
    )


def _free(it: process.Taken) -> int:
    for number in range(it.port + 1, min(it.port + _TRIES, 65535)):
        if process.taken_port(it.protocol, number) is None:
            return number
    return it.port - 1


# --- snapshots --------------------------------------------------------------------------------


def boards(snapshots: Sequence[Snapshot]) -> list[tuple[Snapshot, dict[str, Any]]]:
    """All clients, each with its agent's snapshot."""
    return [(it, client) for it in snapshots for client in it.get("clients", [])]


def check_agents(snapshots: Sequence[Snapshot]) -> Finding:
    """Which agents run, and how many boards each has."""
    if not snapshots:
        return note(
            "agents", "no agent of uros runs under this user", "uros agent udp4 --port 8888"
        )
    told = []
    for it in snapshots:
        count = len(it.get("clients", []))
        told.append(f"pid {it.get('pid')} with {count} board{'s' if count != 1 else ''}")
    if all(not it.get("clients") for it in snapshots):
        return note(
            "agents",
            f"an agent of uros runs, but no board has found it: {', '.join(told)}",
            "compare the board's agent address and port, or device and baud rate, with the agent's",
        )
    return ok("agents", f"agents of uros: {', '.join(told)}")


def check_middleware(snapshots: Sequence[Snapshot]) -> list[Finding]:
    """An agent whose boards reach nobody outside it."""
    return [
        problem(
            "middleware",
            f"the agent {it.get('pid')} runs with -m memory: its boards reach each other, and no"
            " ROS 2 node",
            "start it without -m memory",
        )
        for it in snapshots
        if it.get("middleware") in ("memory", "ced") and it.get("clients")
    ]


_KEY_MEND: Final = (
    "give one of them another key: rmw_uros_options_set_client_key(KEY, rmw_options) in C,"
    " uros.Node(..., key=KEY) in Python"
)


def check_keys(looks: Sequence[Sequence[Snapshot]]) -> list[Finding]:
    """Two boards with one client key, from several looks at the agents, a while apart."""
    if not looks or not looks[-1]:
        return []
    found = _refused_keys(looks[-1])
    for key, places in _places(looks).items():
        at_once = max(map(len, places))
        several = dict.fromkeys(it for some in places for it in some)
        if len(several) < 2 or key in found:
            continue
        where = " and ".join(several)
        if at_once > 1 or _came_back([it for some in places for it in some[:1]]):
            found[key] = problem(
                "client key",
                f"the client key {key} comes from {where}: two boards have it, and push each other"
                " out",
                _KEY_MEND,
            )
        else:
            found[key] = note(
                "client key",
                f"the client key {key} has come from {where}: a board has moved, or two boards"
                " have it",
                _KEY_MEND,
            )
    if not found and boards(looks[-1]):
        return [ok("client key", "every board has a key of its own")]
    return list(found.values())


def _refused_keys(snapshots: Sequence[Snapshot]) -> dict[str, Finding]:
    found = {}
    for it in snapshots:
        for refused in it.get("refused", []):
            if not _about_key(refused):
                continue
            key = str(refused.get("key"))
            here = [one.get("address") for one in it.get("clients", []) if one.get("key") == key]
            who = f"the one at {here[0]}" if here else "another one"
            found[key] = problem(
                "client key",
                f"two boards have the client key {key}: {who} has the session, and the one at"
                f" {refused.get('address')} is refused ({refused.get('times', 1)} times)",
                _KEY_MEND,
            )
    return found


def _about_key(refused: dict[str, Any]) -> bool:
    from ...agent.policy.admission import KEY_IN_USE

    return refused.get("why") == KEY_IN_USE


def _places(looks: Sequence[Sequence[Snapshot]]) -> dict[str, list[list[str]]]:
    """By key: where it was seen, at each look that saw it."""
    agents = {it.get("pid") for it in looks[-1]}
    found: dict[str, list[list[str]]] = {}
    for look in looks:
        seen: dict[str, list[str]] = {}
        for it, client in boards(look):
            if not client.get("address"):
                continue  # kept from an agent before, and not heard since
            place = str(client.get("address"))
            if len(agents) > 1:
                place += f" (agent {it.get('pid')})"
            seen.setdefault(str(client.get("key")), []).append(place)
        for key, places in seen.items():
            found.setdefault(key, []).append(places)
    return found


def _came_back(places: list[str]) -> bool:
    """Whether one place is there again after another one."""
    steps = [it for at, it in enumerate(places) if not at or it != places[at - 1]]
    return len(steps) > len(set(steps))


def check_lines(snapshots: Sequence[Snapshot]) -> list[Finding]:
    """Serial lines that agents serve, and on which nothing, or no frame, or many broken ones come.

    While an agent has a line nobody else can listen, but it counts.
    """
    found = []
    for it in snapshots:
        sound = []
        for line in it.get("transports", []):
            if "crc_errors" not in line:
                continue
            frames = line.get("frames", line.get("messages", 0))
            name, broken, skipped = line.get("label"), line["crc_errors"], line.get("skipped", 0)
            if not frames and skipped >= _NOISE:
                found.append(
                    problem(
                        "line",
                        f"{skipped} bytes came over {name} to the agent {it.get('pid')} and no"
                        " frame among them: another baud rate, or firmware without micro-ROS",
                        f"kill {it.get('pid')}, then: uros doctor --dev {word(str(name))}",
                    )
                )
            elif broken >= _FEW and broken * _BROKEN > frames:
                found.append(
                    problem(
                        "line",
                        f"{broken} of {frames + broken} frames over {name} came broken",
                        "use a shorter cable with a common ground, or a lower rate in the firmware"
                        " and with --baudrate",
                    )
                )
            elif frames:
                sound.append(f"{frames} sound frames came over {name}")
        if len(sound) == 1:
            found.append(ok("line", sound[0]))
        elif sound:
            found.append(ok("line", f"sound frames came over {len(sound)} lines"))
    return found


def check_refused(snapshots: Sequence[Snapshot]) -> list[Finding]:
    """Boards that an agent does not let in, for other reasons than their key."""
    return [
        problem(
            "refused",
            f"the agent {it.get('pid')} refuses the board {one.get('key')} at {one.get('address')}:"
            f" {one.get('why')} ({one.get('times', 1)} times)",
            "change the agent's options for who may come in: uros agent udp4 --help",
        )
        for it in snapshots
        for one in it.get("refused", [])
        if not _about_key(one)
    ]


def of_board(client: dict[str, Any]) -> str:
    """How a board is called: by its nodes, else by its key."""
    nodes = ", ".join(str(it.get("name")) for it in client.get("nodes", []))
    return nodes or f"the board {client.get('key')}"


# A clock that is further off was never set: C clients tell the time since their start.
_NEVER_SET: Final = 500_000_000


def check_clocks(snapshots: Sequence[Snapshot]) -> list[Finding]:
    """Boards whose own clock was off when they last asked their agent for the time.

    What that does to stamps is told by the stamps; a board that uses what it learnt is right.
    """
    found = []
    for _, client in boards(snapshots):
        offset = client.get("clock_offset")
        if isinstance(offset, (int, float)) and CLOCK_LIMIT < abs(offset) < _NEVER_SET:
            way = "behind" if offset < 0 else "ahead of"
            found.append(
                note(
                    "board clock",
                    f"the clock of {of_board(client)} was {abs(offset):.1f} s {way} the agent's"
                    " when it last asked for the time",
                    "ask more often: rmw_uros_sync_session(1000); uros does it every 30 s",
                )
            )
    return found
