"""``uros agent status``: print the state of a running agent and of its boards."""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final

from ...printable import printable_ascii as plain
from ...printable import unguarded
from ..common import AGENT_HELP, agent_choice, positive_float
from ..errors import ToolError
from ..waiting import warn
from .quantities import duration, octets
from .refusals import is_past, keeps_boards_out, others, reason, remedy, what_was_refused

if TYPE_CHECKING:
    from .running_agents import RunningAgent

NAME: Final = "status"
_HELP: Final = "print the state of the running agents: their transports and their boards"
_WATCH: Final = 2.0
# The least width of a column of text on a narrow terminal.
_LEAST: Final = 8
# How many devices of one agent the table of several agents names.
_NAMED: Final = 3

Snapshot = dict[str, Any]


def add_parser(transports: Any) -> None:
    """Declare ``status``, which is given instead of a transport."""
    parser = transports.add_parser(NAME, help=_HELP, description=_HELP)
    parser.add_argument(
        "--agent", type=agent_choice, metavar="PID|CONFIG",
        help=f"{AGENT_HELP} (default: all that run here)",
    )  # fmt: skip
    parser.add_argument(
        "--watch", nargs="?", type=positive_float, const=_WATCH, metavar="SECONDS",
        help=f"print again at this period (default: {_WATCH:g}) until Ctrl-C",
    )  # fmt: skip
    parser.add_argument(
        "--json", action="store_true", help="print each agent's answer as a line of JSON"
    )
    parser.add_argument(
        "--check", action="store_true",
        help="print a line for each agent; exit status 1 unless all of them can serve boards",
    )  # fmt: skip
    parser.add_argument(
        "-v", "--verbose", action="store_true",
        help="print the topics and services of each board too",
    )  # fmt: skip


def run(args: argparse.Namespace) -> int:
    """Print the state once, or repeatedly with ``--watch``.

    Returns:
        0; 1 if an agent does not answer, or cannot serve boards with ``--check``.

    Raises:
        ToolError: No agent runs, or none answers.
    """
    from .running_agents import chosen_agents

    agents = chosen_agents(args.agent)
    if args.check:
        return _check(agents, args.json)
    before: dict[int, Snapshot] = {}
    while True:
        snapshots = _ask_all(agents)
        if args.json:
            for snapshot in snapshots:
                print(json.dumps(snapshot), flush=True)
        else:
            wide = sys.stdout.isatty()
            width = shutil.get_terminal_size().columns if wide else 10_000
            text = "\n".join(_pages(snapshots, before, args.verbose, width))
            # Move to the top and clear from there, in one write: the screen does not flicker.
            if wide and args.watch:
                print(f"\033[H\033[J{text}", file=unguarded(sys.stdout), flush=True)
            else:
                print(text, flush=True)
            if args.watch and not wide:
                print(flush=True)
        if args.watch is None:
            return 0 if len(snapshots) == len(agents) else 1
        before = {snapshot["pid"]: snapshot for snapshot in snapshots}
        time.sleep(args.watch)


def _check(agents: Sequence[RunningAgent], as_json: bool) -> int:
    """Print whether each agent can serve boards; return the exit status."""
    snapshots = _ask_all(agents)
    for snapshot in snapshots:
        if as_json:
            print(json.dumps(snapshot))
            continue
        verdict = "ready" if snapshot.get("ready", True) else "not ready"
        about = "; ".join([_boards_count(snapshot), *snapshot.get("problems", ())])
        config = f" ({plain(snapshot['config'])})" if snapshot.get("config") else ""
        print(f"agent {snapshot['pid']}{config}: {verdict}; {plain(about)}")
    all_ready = all(snapshot.get("ready", True) for snapshot in snapshots)
    return 0 if all_ready and len(snapshots) == len(agents) else 1


def _boards_count(snapshot: Snapshot) -> str:
    clients = snapshot["clients"]
    unheard = sum(not client.get("heard_since_restart", True) for client in clients)
    about = f" ({unheard} not heard since the restart)" * bool(unheard)
    return f"boards: {len(clients)}{about}"


def _ask_all(agents: Sequence[RunningAgent]) -> list[Snapshot]:
    """Return the answers of the agents; an error of one of several is a warning.

    Raises:
        ToolError: None of them answers.
    """
    from .running_agents import ask

    snapshots = []
    errors = []
    for agent in agents:
        try:
            snapshots.append(ask(agent, "status"))
        except ToolError as error:
            errors.append(error)
    if not snapshots:
        raise errors[0]
    for one in errors:
        warn(str(one))
    return snapshots


def _pages(
    snapshots: Sequence[Snapshot], before: dict[int, Snapshot], verbose: bool, width: int
) -> list[str]:
    """Return the lines for all agents: a page of one agent, a table of several, or their pages."""
    if len(snapshots) > 1 and not verbose:
        return overview(snapshots, width)
    lines: list[str] = []
    for snapshot in snapshots:
        lines += [""] * bool(lines)
        lines += page(snapshot, before.get(snapshot["pid"]), verbose, width)
    return lines


# --- the page ---------------------------------------------------------------------------------


def page(
    snapshot: Snapshot, before: Snapshot | None = None, verbose: bool = False, width: int = 80
) -> list[str]:
    """Return the lines of a page.

    Args:
        snapshot: The agent's answer.
        before: An earlier answer: rates are then of the time between.
        verbose: Whether to list the endpoints of each board.
        width: Columns of the terminal.
    """
    lines = [_cut(_head(snapshot, before), width), ""]
    lines += _table(_transports(snapshot), width, "<<>><", 1, 4)
    lines.append("")
    clients = snapshot["clients"]
    if not clients:
        lines += _no_boards(snapshot, width)
    else:
        lines += _boards(_clients(snapshot, before), width)
        lines.append(_cut(f"  in/s, out/s: messages a second{_over(snapshot, before)}", width))
    if snapshot["refused"]:
        lines += ["", *_refused(snapshot, width)]
    for refusal in others(snapshot):
        lines += ["", *_wrapped(_other_refusal(refusal), width, "")]
    for problem in snapshot.get("problems", ()):
        lines += ["", *_wrapped(f"problem: {plain(problem)}", width, "")]
    if verbose:
        for client in clients:
            lines += ["", *_endpoints(client, width)]
    return lines


def overview(snapshots: Sequence[Snapshot], width: int = 80) -> list[str]:
    """Return the lines of a table of several agents: what each serves, and its boards.

    Args:
        snapshots: The agents' answers.
        width: Columns of the terminal.
    """
    rows = [["AGENT", "CONFIG", "UP", "MIDDLEWARE", "BOARDS", "DOMAINS", "SERVES"]]
    for snapshot in snapshots:
        nodes = [node for client in snapshot["clients"] for node in client["nodes"]]
        domains = sorted({node["domain"] for node in nodes})
        head = [
            str(snapshot["pid"]), plain(snapshot.get("config") or "-"),
            duration(snapshot["uptime"]), snapshot["middleware"],
            str(len(snapshot["clients"])), ", ".join(map(str, domains)) or "-",
        ]  # fmt: skip
        for serves in _served(snapshot):
            rows.append([*head, serves])
            head = [""] * len(head)
    if any(snapshot.get("config") for snapshot in snapshots):
        lines = _table(rows, width, "<<<<><<", 5, 6, 1)
        which = "PID|CONFIG"
    else:
        lines = _table([[row[0], *row[2:]] for row in rows], width, "<<<><<", 4, 5)
        which = "PID"
    hint = f"'uros agent status --agent {which}' shows the boards of one agent, -v those of all."
    return [*lines, "", *_wrapped(hint, width, "")]


def _served(snapshot: Snapshot) -> list[str]:
    """Return for each kind of transport what an agent listens on; at least one text."""
    labels: dict[str, list[str]] = {}
    for transport in snapshot["transports"]:
        labels.setdefault(transport["name"], []).append(plain(transport["label"]))
    texts = []
    for name, some in labels.items():
        more = len(some) - _NAMED
        texts.append(f"{name} {', '.join(some[:_NAMED])}{f' and {more} more' * (more > 0)}")
    return texts or ["-"]


def _head(snapshot: Snapshot, before: Snapshot | None) -> str:
    parts = [
        f"agent {snapshot['pid']}",
        f"up {duration(snapshot['uptime'])}",
        f"middleware {snapshot['middleware']}",
    ]
    if snapshot.get("config"):
        parts.insert(1, plain(snapshot["config"]))
    passed = snapshot["uptime"] - before["uptime"] if before else 0
    if before and passed > 0:
        parts.append(f"CPU {100 * (snapshot['cpu'] - before['cpu']) / passed:.1f} %")
    else:
        parts.append(f"CPU {duration(snapshot['cpu'])}")
    if snapshot["rss"] is not None:
        parts.append(f"RSS {octets(snapshot['rss'])}")
    if snapshot["fds"] is not None:
        parts.append(f"{snapshot['fds']} fds")
    return ", ".join(parts)


def _transports(snapshot: Snapshot) -> list[list[str]]:
    rows = [["TRANSPORT", "WHERE", "MESSAGES", "BYTES", ""]]
    for transport in snapshot["transports"]:
        about = []
        if transport.get("connections"):
            about.append(f"{transport['connections']} connected")
        for name, text in (
            ("refused", "refused"), ("crc_errors", "CRC errors"), ("malformed", "malformed"),
            ("foreign", "for others"), ("skipped", "bytes between frames"),
            ("dropped", "not sent"),
        ):  # fmt: skip
            if transport.get(name):
                about.append(f"{transport[name]} {text}")
        rows.append(
            [transport["name"], plain(transport["label"]), f"{transport['messages']:,}",
             octets(transport["bytes"]), ", ".join(about)]
        )  # fmt: skip
    return rows


def _clients(snapshot: Snapshot, before: Snapshot | None) -> list[list[str]]:
    rows = [["BOARD", "ADDRESS", "NODES", "HEARD", "IN/S", "OUT/S", "LOST", "RESENT", "WAITING"]]
    earlier = {client["key"]: client for client in before["clients"]} if before else {}
    for client in snapshot["clients"]:
        rate_in, rate_out = _rates(client, earlier.get(client["key"]))
        nodes = [node_name(node) for node in client["nodes"]]
        queues = client["queues"]
        rows.append(
            [client["key"], plain(client["address"]), " ".join(nodes) or "-",
             _heard(client), f"{rate_in:.1f}", f"{rate_out:.1f}",
             str(client["received"]["lost"] + client["received"]["given_up"]),
             str(client["sent"]["resent"]),
             str(queues["unacknowledged"] + queues["stalled"] + queues["early"])]
        )  # fmt: skip
    return rows


def _heard(client: dict[str, Any]) -> str:
    """Return how long ago a board was heard; a restored session may not have been heard yet."""
    if client.get("heard_since_restart", True):
        return duration(client["heard_ago"])
    return "not since restart"


def _boards(rows: list[list[str]], width: int) -> list[str]:
    """Return the table of boards. If it is too wide, the nodes stand below each board."""
    lines = _table(rows, 10_000, "<<<>>>>>>")
    if max(map(len, lines)) <= width:
        return lines
    lines = _table([row[:2] + row[3:] for row in rows], width, "<<>>>>>>", 1)
    below = [f"  {row[2]}" for row in rows]
    return [
        _cut(line, width)
        for pair in zip(lines, below, strict=True)
        for line in pair
        if line != "  -"
    ]


def node_name(node: dict[str, Any]) -> str:
    """Return a node's name for a table, with its domain unless that is 0."""
    name = plain(node["name"])
    return f"{name}@{node['domain']}" if node["domain"] else name


def _rates(client: dict[str, Any], before: dict[str, Any] | None) -> tuple[float, float]:
    passed = client["age"] - before["age"] if before else 0
    if before is None or passed <= 0:
        return client["received"]["rate"], client["sent"]["rate"]
    return (
        (client["received"]["messages"] - before["received"]["messages"]) / passed,
        (client["sent"]["messages"] - before["sent"]["messages"]) / passed,
    )


def _over(snapshot: Snapshot, before: Snapshot | None) -> str:
    if before:
        return ", since the previous time"
    longest = max(client["rate_over"] for client in snapshot["clients"])
    return f", over the last {duration(longest)}"


def _refused(snapshot: Snapshot, width: int) -> list[str]:
    from ...agent.policy.admission import rule_of

    rows = [["REFUSED", "ADDRESS", "TIMES", "LAST", "WHY"]]
    rows += [
        [refusal["key"], plain(refusal["address"]), str(refusal["times"]),
         f"{duration(refusal['ago'])} ago", plain(refusal["why"])]
        for refusal in snapshot["refused"]
    ]  # fmt: skip
    lines = _table(rows, width, "<<>><", 4, 1)
    for why in dict.fromkeys(refusal["why"] for refusal in snapshot["refused"]):
        lines += _wrapped(f"{plain(why)}: {remedy(rule_of(why), why)}", width)
    return lines


def _no_boards(snapshot: Snapshot, width: int) -> list[str]:
    """Return lines about what boards need to connect, and about serial lines with noise alone."""
    from ..doctor.agents import has_noise_alone

    serial = [each for each in snapshot["transports"] if "crc_errors" in each]
    if keeps_boards_out(snapshot):
        lines = ["No boards. Some may be among what the agent refuses, see below."]
    elif len(serial) < len(snapshot["transports"]):
        lines = ["No boards. Their firmware must know this host's address and the port."]
    else:
        lines = ["No boards. Their firmware must send at the baud rate of this agent."]
    for each in serial:
        if has_noise_alone(each):
            device = plain(each["label"])
            lines += _wrapped(
                f"{device} has bytes and no frame: another baud rate, or firmware without"
                f" micro-ROS; stop this agent, and 'uros doctor --dev {device}' finds out", width,
            )  # fmt: skip
    return lines


def _other_refusal(refusal: dict[str, Any]) -> str:
    """Return a line about refusals of peers that have no client key yet, or of objects."""
    parts = [what_was_refused(refusal), reason(refusal)]
    if not is_past(refusal) and (mend := remedy(refusal["rule"], refusal["why"])):
        parts.append(mend)
    text = ": ".join(parts)
    return plain(text[0].upper() + text[1:])


def _wrapped(text: str, width: int, first: str = "  ") -> list[str]:
    import textwrap

    return textwrap.wrap(
        text, min(width, 100), initial_indent=first, subsequent_indent="  ",
        break_on_hyphens=False,
    )  # fmt: skip


def _endpoints(client: dict[str, Any], width: int) -> list[str]:
    objects = ", ".join(
        f"{count} {kind}{'s' * (count > 1)}" for kind, count in client["objects"].items()
    )
    head = (
        f"{client['key']}: session {client['session_id']}, {client['transport']}, MTU"
        f" {client['mtu']}, for {duration(client['age'])}; {objects or 'no objects'}"
    )
    queues = client["queues"]
    waits = [
        f"{queues[name]} {text}"
        for name, text in (
            ("unacknowledged", "sent and not acknowledged"), ("stalled", "wait for the network"),
            ("early", "came early"),
        )
        if queues[name]
    ]  # fmt: skip
    lines = _wrapped(head, width, "")
    if waits:
        lines.append(_cut(f"  messages: {', '.join(waits)}", width))
    if queues["fragments"]:
        lines.append(f"  bytes of fragments: {queues['fragments']}")
    if client["sent"]["dropped"]:
        lines.append(_cut(f"  dropped: {client['sent']['dropped']}", width))
    if client["clock_offset"] is not None:
        lines.append(_cut(f"  its clock minus the agent's: {client['clock_offset']:+.3f} s", width))
    rows = [
        ["  " + endpoint["kind"], plain(endpoint["topic"]), plain(endpoint["type"]),
         f"{endpoint['samples']:,}"]
        for endpoint in client["endpoints"]
    ]  # fmt: skip
    if rows:
        header = ["  ENDPOINT", "TOPIC", "TYPE", "SAMPLES"]
        lines += _table([header, *rows], width, "<<<>", 2, 1)
    if client.get("endpoints_left_out"):
        lines.append(f"  and {client['endpoints_left_out']} more")
    return lines


# --- text ------------------------------------------------------------------------------------


def _cut(text: str, width: int) -> str:
    return text if len(text) <= width else text[: max(0, width - 3)] + "..."


def _table(rows: list[list[str]], width: int, aligned: str, *narrow: int) -> list[str]:
    """Return rows as aligned lines. If too wide, the columns ``narrow`` are cut in turn."""
    sizes = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for column in narrow:
        over = sum(sizes) + 2 * (len(sizes) - 1) - width
        if over > 0:
            sizes[column] = max(min(sizes[column], _LEAST), sizes[column] - over)
    return [
        _cut(
            "  ".join(
                f"{_cut(cell, size):{way}{size}}"
                for cell, size, way in zip(row, sizes, aligned, strict=True)
            ).rstrip(),
            width,
        )
        for row in rows
    ]
