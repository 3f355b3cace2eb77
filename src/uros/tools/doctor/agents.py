"""Checks the agents on this machine: their ports, and their boards as the snapshots show them."""

from __future__ import annotations

import socket
from collections.abc import Collection, Mapping, Sequence
from typing import Any, Final

from ..agent.quantities import duration
from ..agent.refusals import (
    is_past,
    keeps_boards_out,
    others,
    reason,
    remedy,
    what_was_refused,
)
from . import process
from .finding import Finding, note, ok, problem, unknown, word

# An offset of a board's clock that disturbs sensor fusion, in seconds.
CLOCK_LIMIT: Final = 0.1
# Faults of a line: bytes without a frame; broken frames, how many at least and one in how many.
_NOISE: Final = 16
_FEW: Final = 5
_BROKEN: Final = 20
# How long a board may be silent, in seconds: the agent asks it after half of that at the latest.
_SILENT: Final = 60.0
# How many ports are tried to suggest a free one.
_TRIES: Final = 64

Snapshot = dict[str, Any]


# --- ports ------------------------------------------------------------------------------------


def check_port(port: int, agents: Collection[int] = (), asked: bool = True) -> list[Finding]:
    """Check whether an agent can listen on a port over UDP and TCP.

    Args:
        port: The port.
        agents: Process ids of uros agents.
        asked: Whether the user named the port. Otherwise a taken TCP port is only a note: few
            boards use TCP, and many programs use port 8888.
    """
    if not process.can_look():
        return [unknown("port", "this system has no /proc, which tells who uses a port")]
    taken = [process.taken_port(protocol, port) for protocol in ("udp", "tcp")]
    if not any(taken):
        return [ok("port", f"port {port} is free, for UDP and for TCP")]
    ports = [entry for entry in taken if entry is not None]
    return [_taken(entry, agents, asked or entry.protocol == "udp") for entry in ports]


def _taken(port: process.Taken, agents: Collection[int], grave: bool) -> Finding:
    where = f"{port.protocol.upper()} port {port.port}"
    fix = (
        f"use another port: uros agent {port.protocol}4 --port {_free(port)}, and set it in the"
        " boards"
    )
    if not port.holders:
        return (problem if grave else note)(
            "port",
            f"{where} is in use by a process of another user",
            f"show the process: sudo ss -lpn 'sport = :{port.port}'; or {fix}",
        )
    names = " and ".join(map(str, port.holders))
    kill = "kill " + " ".join(str(holder.pid) for holder in port.holders)
    if all(holder.pid in agents or holder.is_uros_agent for holder in port.holders):
        return ok("port", f"{where} is served by a uros agent: {names}",
                  f"only if you want to start another agent in its place: {kill}")  # fmt: skip
    if any(holder.is_foreign_agent for holder in port.holders):
        names += ", eProsima's agent"
    return (problem if grave else note)(
        "port", f"{where} is in use by {names}", f"{kill}; or {fix}"
    )


def _free(port: process.Taken) -> int:
    for number in range(port.port + 1, min(port.port + _TRIES, 65535)):
        if process.taken_port(port.protocol, number) is None and _can_bind(port.protocol, number):
            return number
    return port.port - 1


def _can_bind(protocol: str, number: int) -> bool:
    """Return whether an agent could open a port: a connection's own port is not free either."""
    kind = socket.SOCK_STREAM if protocol == "tcp" else socket.SOCK_DGRAM
    with socket.socket(socket.AF_INET, kind) as sock:
        if kind == socket.SOCK_STREAM:
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            sock.bind(("0.0.0.0", number))
        except OSError:
            return False
    return True


# --- snapshots --------------------------------------------------------------------------------


def boards(snapshots: Sequence[Snapshot]) -> list[tuple[Snapshot, dict[str, Any]]]:
    """Return all clients, each with its agent's snapshot."""
    return [(snapshot, client) for snapshot in snapshots for client in snapshot.get("clients", [])]


def check_agents(snapshots: Sequence[Snapshot]) -> Finding:
    """Report which agents run, and how many boards each has."""
    if not snapshots:
        return note("agents", "no uros agent runs under this user", "uros agent udp4 --port 8888")
    agents = []
    for snapshot in snapshots:
        count = len(snapshot.get("clients", []))
        config = f" ({snapshot['config']})" if snapshot.get("config") else ""
        agents.append(
            f"pid {snapshot.get('pid')}{config} with {count} board{'s' if count != 1 else ''}"
        )
    if all(not snapshot.get("clients") for snapshot in snapshots):
        running = "a uros agent runs" if len(snapshots) == 1 else "uros agents run"
        fix = (
            "compare the board's agent address and port, or device and baud rate, with the agent's"
        )
        if any(map(keeps_boards_out, snapshots)):
            fix = "the board may be among what is refused, see below"
        return note("agents", f"{running}, but no board is connected: {', '.join(agents)}", fix)
    alone = "to check one of them alone: uros doctor --agent PID" if len(snapshots) > 1 else ""
    return ok("agents", f"uros agents: {', '.join(agents)}", alone)


def check_problems(snapshots: Sequence[Snapshot]) -> list[Finding]:
    """Report what agents say is wrong with themselves."""
    return [
        problem(
            "agent",
            f"the agent {snapshot.get('pid')} has a problem: {text}",
            f"mend that, then check: uros agent status --agent {snapshot.get('pid')}",
        )
        for snapshot in snapshots
        for text in snapshot.get("problems", ())
    ]


def check_silence(snapshots: Sequence[Snapshot]) -> list[Finding]:
    """Find boards that are connected and have been silent for long."""
    findings = []
    for snapshot, client in boards(snapshots):
        ago, key = client.get("heard_ago", 0.0), str(client.get("key"))
        if ago < _SILENT:
            continue
        silence = f"for {duration(ago)}"
        if not client.get("heard_since_restart", True):
            silence = f"since the agent's restart {duration(ago)} ago"
        findings.append(
            note(
                "silent board",
                f"the board {key} at {client.get('address')} has sent nothing to the agent"
                f" {snapshot.get('pid')} {silence}",
                "check its power and its line or network",
                about=key,
            )
        )
    return findings


def check_middleware(snapshots: Sequence[Snapshot]) -> list[Finding]:
    """Find agents whose boards reach no ROS 2 node."""
    return [
        problem(
            "middleware",
            f"the agent {snapshot.get('pid')} runs with -m memory: its boards reach only each"
            " other, and no ROS 2 node",
            "start it without -m memory",
        )
        for snapshot in snapshots
        if snapshot.get("middleware") in ("memory", "ced") and snapshot.get("clients")
    ]


_KEY_FIX: Final = (
    "give one of them another key: rmw_uros_options_set_client_key(KEY, rmw_options) in C,"
    " uros.Node(..., key=KEY) in Python"
)


def check_keys(looks: Sequence[Sequence[Snapshot]]) -> list[Finding]:
    """Find boards of one agent that have the same client key.

    Two boards on two agents may have one key: each agent has its own clients.

    Args:
        looks: The agents' snapshots at several times, a while apart.
    """
    if not looks or not looks[-1]:
        return []
    findings = _refused_keys(looks[-1])
    for (_, key), places in _places(looks).items():
        at_once = max(map(len, places))
        several = dict.fromkeys(place for some in places for place in some)
        if len(several) < 2 or key in findings:
            continue
        where = " and ".join(several)
        if at_once > 1 or _came_back([place for some in places for place in some[:1]]):
            findings[key] = problem(
                "client key",
                f"the client key {key} comes from {where}: two boards have it, and each ends the"
                " session of the other",
                _KEY_FIX,
                about=key,
            )
        else:
            findings[key] = note(
                "client key",
                f"the client key {key} has come from {where}: a board changed its address, or two"
                " boards have the key",
                _KEY_FIX,
                about=key,
            )
    if not findings and boards(looks[-1]):
        return [ok("client key", "no two boards of an agent have the same key")]
    return list(findings.values())


def _refused_keys(snapshots: Sequence[Snapshot]) -> dict[str, Finding]:
    findings = {}
    for snapshot in snapshots:
        for refused in snapshot.get("refused", []):
            if not _about_key(refused):
                continue
            key = str(refused.get("key"))
            clients = snapshot.get("clients", [])
            addresses = [client.get("address") for client in clients if client.get("key") == key]
            holder = f"the one at {addresses[0]}" if addresses else "another one"
            findings[key] = problem(
                "client key",
                f"two boards have the client key {key}: {holder} has the session, and the one at"
                f" {refused.get('address')} is refused ({refused.get('times', 1)} times)",
                _KEY_FIX,
                about=key,
                kind="refused",
            )
    return findings


def _about_key(refused: dict[str, Any]) -> bool:
    from ...agent.policy.admission import KEY_IN_USE

    return refused.get("why") == KEY_IN_USE


def _places(looks: Sequence[Sequence[Snapshot]]) -> dict[tuple[Any, str], list[list[str]]]:
    """Return by agent and key the addresses in each snapshot that has the key."""
    agents = {snapshot.get("pid") for snapshot in looks[-1]}
    by_key: dict[tuple[Any, str], list[list[str]]] = {}
    for look in looks:
        seen: dict[tuple[Any, str], list[str]] = {}
        for snapshot, client in boards(look):
            if not client.get("address"):
                continue  # restored from a state file, and silent since
            place = str(client.get("address"))
            if len(agents) > 1:
                place += f" (agent {snapshot.get('pid')})"
            seen.setdefault((snapshot.get("pid"), str(client.get("key"))), []).append(place)
        for key, places in seen.items():
            by_key.setdefault(key, []).append(places)
    return by_key


def _came_back(places: list[str]) -> bool:
    """Whether one place appears again after another one."""
    steps = [place for at, place in enumerate(places) if not at or place != places[at - 1]]
    return len(steps) > len(set(steps))


def check_lines(snapshots: Sequence[Snapshot]) -> list[Finding]:
    """Check the serial lines of agents for missing and broken frames, by the agents' counters.

    Nobody else can listen on a line while an agent uses it.
    """
    findings = []
    for snapshot in snapshots:
        sound = []
        for line in snapshot.get("transports", []):
            if "crc_errors" not in line:
                continue
            frames = _frames(line)
            name, broken, skipped = line.get("label"), line["crc_errors"], line.get("skipped", 0)
            if has_noise_alone(line):
                findings.append(
                    problem(
                        "line",
                        f"{skipped} bytes came over {name} to the agent {snapshot.get('pid')},"
                        " without a frame: another baud rate, or firmware without micro-ROS",
                        f"kill {snapshot.get('pid')}, then: uros doctor --dev {word(str(name))}",
                        about=str(name),
                        kind="no frame",
                    )
                )
            elif broken >= _FEW and broken * _BROKEN > frames:
                findings.append(
                    problem(
                        "line",
                        f"{broken} of {frames + broken} frames over {name} came broken",
                        "use a shorter cable with a common ground, or a lower rate in the firmware"
                        " and with --baudrate",
                        about=str(name),
                        kind="broken",
                    )
                )
            elif frames:
                sound.append(f"{frames} sound frames came over {name}")
        if len(sound) == 1:
            findings.append(ok("line", sound[0]))
        elif sound:
            findings.append(ok("line", f"sound frames came over {len(sound)} lines"))
    return findings


def check_refused(snapshots: Sequence[Snapshot]) -> list[Finding]:
    """Find boards that an agent refuses, for other reasons than a key in use."""
    from ...agent.policy.admission import rule_of

    findings = []
    for snapshot in snapshots:
        for client in snapshot.get("refused", []):
            why, key = str(client.get("why")), str(client.get("key"))
            if _about_key(client) or is_past(client):
                continue
            what = (
                f"the agent {snapshot.get('pid')} refuses the board {key} at"
                f" {client.get('address')}: {why} ({client.get('times', 1)} times)"
            )
            findings.append(
                problem("refused", what, remedy(rule_of(why), why), about=key, kind=why)
            )
    return findings


def check_others_refused(snapshots: Sequence[Snapshot]) -> list[Finding]:
    """Report refused connections and messages of peers without a key, and refused requests.

    They are notes, for a stranger may have sent them; unless nobody else reaches the agent.
    """
    findings = []
    for snapshot in snapshots:
        for refusal in others(snapshot):
            tls = refusal["rule"] == "tls"
            what = f"agent {snapshot.get('pid')}: {what_was_refused(refusal)}: {reason(refusal)}"
            if is_past(refusal):
                findings.append(ok("tls" if tls else "refused", what))
                continue
            alone = refusal["kind"] == "connection" and not snapshot.get("clients")
            fix = remedy(refusal["rule"], refusal["why"])
            if alone:
                fix = fix or "compare the TLS settings of the board with the agent's"
            state = problem if alone else note
            findings.append(state("tls" if tls else "refused", what, fix))
    return findings


def _frames(line: Mapping[str, Any]) -> int:
    """Return the frames of a line, or the messages, which an earlier version counts."""
    frames: int = line.get("frames", line.get("messages", 0))
    return frames


def has_noise_alone(line: Mapping[str, Any]) -> bool:
    """Return whether bytes have come over a serial line of a snapshot, and no frame."""
    return "crc_errors" in line and not _frames(line) and line.get("skipped", 0) >= _NOISE


def of_board(client: dict[str, Any]) -> str:
    """Return how to name a board: by its nodes, else by its key."""
    nodes = ", ".join(str(node.get("name")) for node in client.get("nodes", []))
    return nodes or f"the board {client.get('key')}"


# A clock that is further off was never set: C clients send the time since their start.
_NEVER_SET: Final = 500_000_000


def check_clocks(snapshots: Sequence[Snapshot]) -> list[Finding]:
    """Find boards whose clock was off when they last synchronized with their agent.

    Their stamps may still be right: a board can correct them by the offset. `check_stamps` tells.
    """
    findings = []
    for _, client in boards(snapshots):
        offset = client.get("clock_offset")
        if isinstance(offset, (int, float)) and CLOCK_LIMIT < abs(offset) < _NEVER_SET:
            way = "behind" if offset < 0 else "ahead of"
            findings.append(
                note(
                    "board clock",
                    f"the clock of {of_board(client)} was {abs(offset):.1f} s {way} the agent's"
                    " at its last time synchronization",
                    "synchronize more often: rmw_uros_sync_session(1000); uros does so every 30 s",
                    about=of_board(client),
                    kind=way,
                )
            )
    return findings
