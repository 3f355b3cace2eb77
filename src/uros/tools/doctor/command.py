"""``uros doctor``: find out why boards and ROS 2 nodes do not communicate on this machine."""

from __future__ import annotations

import argparse
import itertools
import json
import os
import re
import shutil
import sys
import textwrap
import time
from collections.abc import Callable, Iterable, Iterator
from typing import TYPE_CHECKING, Final

from ...agent.transports.base import DEFAULT_PORT
from ...printable import printable, unguarded
from ..common import AGENT_HELP, agent_choice, positive_float
from ..common import domain as domain_number
from .finding import NOTE, OK, PROBLEM, UNKNOWN, Finding, merge_alike, problem, unknown
from .snapshots import Agents

if TYPE_CHECKING:
    from .graph import End
    from .report import Report

_SECONDS: Final = 3.0
# As in agent/transports/baud.py, which cannot be imported where there is no termios.
_MAX_BAUD: Final = 50_000_000
_WIDTH: Final = 100
_LEAST_WIDTH: Final = 60
_COLOURS: Final = {OK: "\033[32m", NOTE: "\033[33m", PROBLEM: "\033[1;31m", UNKNOWN: "\033[35m"}
_INDENT: Final = " " * 24
# How often agents are asked, to see boards that end each other's sessions, in seconds.
_LOOK_AGAIN: Final = 0.5
_EPILOG: Final = """\
Prints one line for each check, and a fix below each problem. It changes nothing. With --dev it
opens the device and listens, which may reset the board; no agent may use the device then. The exit
status is 1 if there is a problem.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros doctor``."""
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = _EPILOG
    parser.add_argument(
        "--dev", metavar="DEVICE", help="serial device of a board to check and to listen on"
    )
    parser.add_argument(
        "--baudrate", type=_baudrate, default=115200, metavar="N",
        help="baud rate of the board (default: 115200)",
    )  # fmt: skip
    parser.add_argument(
        "--port", type=_port, metavar="N",
        help=f"port of the agent (default: {DEFAULT_PORT})",
    )  # fmt: skip
    parser.add_argument(
        "--domain", type=domain_number, metavar="N", action="append", default=[],
        help="ROS domain of your nodes; may be repeated (default: ROS_DOMAIN_ID, and 0)",
    )  # fmt: skip
    parser.add_argument(
        "--agent", type=agent_choice, metavar="PID|CONFIG",
        help=f"the only agent to check: {AGENT_HELP}",
    )  # fmt: skip
    parser.add_argument(
        "--seconds", type=positive_float, default=_SECONDS, metavar="S",
        help=f"seconds of each listening (default: {_SECONDS:g})",
    )  # fmt: skip
    parser.add_argument("--json", action="store_true", help="print one JSON object at the end")
    group = parser.add_mutually_exclusive_group()
    group.add_argument(
        "-r", "--report", action="store_true",
        help="print what this machine, its networks, topics and QoS are, without checks",
    )  # fmt: skip
    group.add_argument(
        "-rf", "--report-failed", action="store_true",
        help="print that report behind the checks if one of them has found a problem",
    )  # fmt: skip
    parser.add_argument(
        "-iw", "--include-warnings", action="store_true", help="take notes for problems"
    )
    parser.add_argument(
        "-ep", "--exclude-packages", action="store_true",
        help="do not report the versions of Python packages",
    )  # fmt: skip


def _baudrate(text: str) -> int:
    if not text.isdecimal() or len(text) > 8 or not 0 < int(text) <= _MAX_BAUD:
        raise argparse.ArgumentTypeError(f"{text!r} is not a baud rate, such as 115200")
    return int(text)


def _port(text: str) -> int:
    if not text.isdecimal() or len(text) > 5 or not 0 < int(text) < 65536:
        raise argparse.ArgumentTypeError(f"{text!r} is not a port (1 to 65535)")
    return int(text)


def run(args: argparse.Namespace, agents: Agents | None = None) -> int:
    """Make all checks and print the findings.

    Args:
        args: The command line.
        agents: Asks the agents of this machine; a test's own ones.

    Returns:
        1 if a check found a problem, else 0.
    """
    if args.report:
        _report(args)
        return 0
    doctor = Doctor(args, agents or Agents(args.agent), None if args.json else print_finding)
    doctor.examine()
    wrong = (PROBLEM, NOTE) if args.include_warnings else (PROBLEM,)
    problems = sum(finding.state in wrong for finding in doctor.findings)
    if args.json:
        told = [finding.plain() for finding in doctor.findings]
        print(json.dumps({"version": 1, "problems": problems, "findings": told}, indent=2))
    else:
        print(_summary(doctor.findings))
    if problems and args.report_failed and not args.json:
        _report(args)
    return 1 if problems else 0


def _report(args: argparse.Namespace) -> None:
    """Print the report, as ros2 prints one."""
    parts = _parts(args)
    if args.json:
        print(json.dumps([part._asdict() for part in parts]))
        return
    for part in parts:
        print("\n".join(part.lines()), flush=True)


def _parts(args: argparse.Namespace) -> Iterator[Report]:
    from ...host.network import Network
    from ...middleware.environment import environment_domain
    from . import graph, report

    yield from report.machine(not args.exclude_packages)
    for domain in dict.fromkeys(args.domain or [environment_domain()]):
        with Network(domain) as network:
            network.settle()
            ours = {node for node in network.graph.nodes() if node == f"/_uros_{os.getpid()}"}
            yield from report.domain(domain, graph.Picture(network.graph, ours))


def print_finding(finding: Finding) -> None:
    """Print a finding, in colour on a terminal."""
    width = _WIDTH
    coloured = sys.stdout.isatty()
    if coloured:
        width = max(_LEAST_WIDTH, min(_WIDTH, shutil.get_terminal_size().columns))
    text = lines(finding, width)
    if coloured and not os.environ.get("NO_COLOR"):
        text = f"{_COLOURS[finding.state]}{finding.state}\033[0m" + text[len(finding.state) :]
    print(text, file=unguarded(sys.stdout) if coloured else sys.stdout, flush=True)


def lines(finding: Finding, width: int = _WIDTH) -> str:
    """Return a finding as it is printed: the sentence, and the fix on lines of its own.

    Args:
        finding: What to print.
        width: Columns of the terminal. A command in a fix stays on one line even if it is longer,
            so that it can be copied.
    """
    head = f"{finding.state:<9}{finding.check:<15}"
    told = textwrap.wrap(
        printable(finding.what), width - len(head), break_long_words=False, break_on_hyphens=False
    )
    out = [head + f"\n{_INDENT}".join(told)]
    if finding.fix:
        label = "fix:" if finding.state in (PROBLEM, UNKNOWN) else "hint:"
        fixes = _wrap_fix(printable(finding.fix), width - len(_INDENT))
        out.append(f"{'':<9}{label:<15}" + f"\n{_INDENT}".join(fixes))
    return "\n".join(out)


def _wrap_fix(text: str, width: int) -> list[str]:
    """Break a fix between its parts, never within a command."""
    wrapped = [""]
    for part in re.split(r"(?<=[,;:]) ", text):
        joined = f"{wrapped[-1]} {part}".lstrip()
        if wrapped[-1] and len(joined) > width:
            wrapped.append(part)
        else:
            wrapped[-1] = joined
    return wrapped


def _summary(findings: list[Finding]) -> str:
    def count(state: str, one: str, more: str) -> str:
        number = sum(finding.state == state for finding in findings)
        return f"{number} {one if number == 1 else more}"

    told = [count(PROBLEM, "problem", "problems")]
    if any(finding.state == NOTE for finding in findings):
        told.append(count(NOTE, "note", "notes"))
    if any(finding.state == UNKNOWN for finding in findings):
        told.append(count(UNKNOWN, "check", "checks") + " could not be made")
    return "\n" + ", ".join(told)


class Doctor:
    """Makes all checks once.

    Args:
        args: The command line.
        agents: Asks the agents of this machine.
        tell: Called with the findings of each check as soon as they are made; many that are alike
            are one.
    """

    def __init__(
        self,
        args: argparse.Namespace,
        agents: Agents,
        tell: Callable[[Finding], object] | None = None,
    ) -> None:
        self.findings: list[Finding] = []
        self._args = args
        self._agents = agents
        self._tell = tell

    def _found(self, findings: Iterable[Finding]) -> None:
        new = [each for each in dict.fromkeys(findings) if each not in self.findings]
        self.findings += new
        if self._tell is not None:
            for finding in merge_alike(new):
                self._tell(finding)

    def _say(self, text: str) -> None:
        print(f"... {printable(text)}", file=sys.stderr, flush=True)

    def examine(self) -> None:
        """Make the checks. Their findings are in ``findings``."""
        from . import agents as doctor_agents
        from . import clock

        began = time.monotonic()
        agents = self._agents
        agents.look()
        self._found(agents.failed)
        if not agents.failed:
            self._found([doctor_agents.check_agents(agents.now)])
        self._found(doctor_agents.check_problems(agents.now))
        self._serial()
        port = self._args.port or DEFAULT_PORT
        self._found(doctor_agents.check_port(port, agents.pids, self._args.port is not None))
        wanted = self._wanted()
        self._environment(wanted[0] if wanted else 0)
        self._graphs(wanted)
        self._keys(began)
        for check in (
            doctor_agents.check_silence,
            doctor_agents.check_refused,
            doctor_agents.check_others_refused,
            doctor_agents.check_middleware,
            doctor_agents.check_lines,
            doctor_agents.check_clocks,
        ):
            self._found(check(agents.now))
        self._found([clock.check_host()])

    # --- lines ----------------------------------------------------------------------------------

    def _serial(self) -> None:
        from . import serial

        args, agents = self._args, self._agents.pids
        if args.dev is None:
            checked = (serial.check_device(each, agents, touch=False) for each in serial.ports())
            self._found(itertools.chain.from_iterable(checked))
            return
        found = serial.check_device(args.dev, agents)
        self._found(found)
        if found[-1].state == OK:
            line = serial.DeviceLine(args.dev)
            self._found([serial.check_line(args.dev, line, args.baudrate, args.seconds, self._say)])

    # --- discovery ------------------------------------------------------------------------------

    def _environment(self, domain: int) -> None:
        from . import network as doctor_network
        from . import process

        self._found(doctor_network.check_engine())
        here = os.environ
        places = [(here, doctor_network.SHELL)]
        for pid in sorted(self._agents.pids - {os.getpid()}):
            there = process.environment(pid)
            names = ("ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_LOCALHOST_ONLY", "CYCLONEDDS_URI",
                     "ROS_STATIC_PEERS", "ROS_SECURITY_ENABLE")  # fmt: skip
            if there is None:
                continue
            if any(here.get(name, "") != there.get(name, "") for name in names):
                places.append((there, f"the agent {pid}"))  # type: ignore[arg-type]
        for environment, whose in places:
            self._found(doctor_network.check_range(environment, whose))
            self._found(doctor_network.check_cyclone(environment, whose))
            self._found(doctor_network.check_security(environment, whose))
        self._found(doctor_network.check_multicast(here, domain))
        self._found(doctor_network.check_firewall())

    def _wanted(self) -> list[int]:
        """Return the domains of the user's own nodes."""
        from ...middleware.base import MiddlewareError
        from ...middleware.environment import environment_domain

        if self._args.domain:
            return list(dict.fromkeys(self._args.domain))
        try:
            return [environment_domain()]
        except MiddlewareError as error:
            self._found([problem("domain", str(error), "export ROS_DOMAIN_ID=0")])
            return []

    def _graphs(self, wanted: list[int]) -> None:
        """Check every domain in which boards or nodes may be."""
        from . import graph

        boards = self._agents.nodes()
        besides = [] if self._args.domain else [0]
        domains = list(dict.fromkeys([*wanted, *(domain for _, domain in boards), *besides]))
        found = {}
        for domain in domains:
            ends = self._graph(domain, boards)
            if ends is not None:
                found[domain] = ends
        if wanted and found:
            self._found(graph.check_domains(found, boards, wanted, self._agents.domains()))

    def _graph(self, domain: int, boards: list[tuple[str, int]]) -> list[End] | None:
        """Check one domain; return the endpoints of its topics, or None if it cannot be joined."""
        from ...host.network import Network
        from ...middleware.base import MiddlewareError
        from . import clock, graph, qos

        names = {name for name, its_domain in boards if its_domain == domain}
        known = names if self._agents.now else None
        self._say(f"looking at domain {domain}")
        try:
            with Network(domain) as network:
                network.settle()
                ours = {node for node in network.graph.nodes() if node == f"/_uros_{os.getpid()}"}
                picture = graph.Picture(network.graph, ours)
                self._found(graph.check_names(picture, domain))
                self._found(graph.check_types(picture, domain))
                self._found(qos.check_qos(picture, domain, names))
                ends = graph.ends(picture)
                self._found(
                    clock.check_stamps(network, picture, self._args.seconds, known, self._say)
                )
                return ends
        except MiddlewareError as error:
            self._found([unknown("graph", f"domain {domain} cannot be joined: {error}")])
            return None

    # --- boards ---------------------------------------------------------------------------------

    def _keys(self, began: float) -> None:
        """Ask the agents for as long as boards with one key take to end each other's sessions."""
        from .agents import check_keys

        agents = self._agents
        if agents.now:
            end = began + self._args.seconds
            agents.look()
            while agents.now and time.monotonic() < end:
                time.sleep(_LOOK_AGAIN)
                agents.look()
        self._found(check_keys(agents.looks))
