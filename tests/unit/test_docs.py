"""The pages agree with the code: tests, options, files, links, metrics, output, commands."""

import argparse
import ast
import importlib
import re
import shutil
import ssl
import subprocess
from functools import lru_cache
from importlib import import_module
from pathlib import Path

import pytest
from unit.test_house import ALLOWED

from uros.agent.policy.rules import Rules
from uros.boards.virtual.hardware.board import VirtualBoard
from uros.boards.virtual.hardware.clock import ManualClock
from uros.boards.virtual.models.catalog import BOARDS, find
from uros.qos import QoSProfile, ReliabilityPolicy
from uros.tools import cli
from uros.tools.agent import command

ROOT = Path(__file__).resolve().parents[2]
PAGES = [
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "SECURITY.md")),
    *sorted((ROOT / "docs").rglob("*.md")),
    *sorted((ROOT / "firmware").rglob("*.md")),
]
README = ROOT / "README.md"
HOUSE = ROOT / "docs" / "design" / "README.md"
NUMBERS = ROOT / "docs" / "design" / "numbers.md"
EXAMPLES = ROOT / "firmware" / "README.md"
CONTRIBUTING = ROOT / "CONTRIBUTING.md"
AGENT = ROOT / "docs" / "agent.md"
CLIENT = ROOT / "docs" / "client.md"
DOCTOR = ROOT / "docs" / "doctor.md"
INTERFACES = ROOT / "docs" / "interfaces.md"
ROBUSTNESS = ROOT / "docs" / "robustness.md"
SECURITY = ROOT / "docs" / "security.md"
SEEING = ROOT / "docs" / "seeing.md"
TRANSPORTS = ROOT / "docs" / "board_transports.md"
ROS2_CASES = ROOT / "docs" / "ros2_cases.md"
ROS2_COMMANDS = ROOT / "docs" / "ros2_commands.md"
NAMED = re.compile(r"`([\w/.]+\.py)::(\w+)`")

# Options on the page of the agent that are not its own.
FOREIGN = {"--ros-args"}


def name_of(page):
    return str(page.relative_to(ROOT))


@lru_cache
def names_in(path):
    """Return the names of the test functions of a file."""
    tree = ast.parse((ROOT / "tests" / path).read_text("utf-8"))
    return {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}


@lru_cache
def happenings():
    """Return the actions and faults of virtual boards without values, and the names of parts."""
    specs = set()
    for name in BOARDS:
        board = VirtualBoard(find(name), ManualClock(), plugs=["esp8266:uart=7", "wlan"])
        try:
            specs |= {happening.spec for happening in (*board.acts(), *board.faults())}
        finally:
            board.close()
    names = {spec.partition(":")[0] for spec in specs}
    return specs | {f"{name}:off" for name in (*names, "all")}, names


@pytest.mark.parametrize(
    "page",
    [
        README,
        *(ROOT / "docs" / f"{name}.md" for name in ("boards", "virtual_boards")),
        *sorted((ROOT / "firmware").rglob("README.md")),
    ],
    ids=name_of,
)
def test_actions_faults_and_boards_on_a_page_exist(page):
    text = page.read_text("utf-8")
    known, parts = happenings()
    specs = re.findall(r"`(\w+):(\w+)(?:=[^`]*)?`", text)
    wrong = [f"{a}:{b}" for a, b in specs if a in parts and f"{a}:{b}" not in known]
    assert not wrong, f"there is no {', '.join(wrong)}"
    boards = set(re.findall(r"uros board run (\w+)", text)) - {"NAME"}
    assert boards <= set(BOARDS), f"there is no board {', '.join(sorted(boards - set(BOARDS)))}"


def test_every_board_is_on_the_page_of_boards():
    text = (ROOT / "docs" / "boards.md").read_text("utf-8")
    assert set(re.findall(r"uros board run (\w+)", text)) - {"NAME"} == set(BOARDS)


# --- tests ------------------------------------------------------------------------------------


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_every_test_that_a_page_names_exists(page):
    missing = [
        f"{path}::{name}"
        for path, name in NAMED.findall(page.read_text("utf-8"))
        if not (ROOT / "tests" / path).is_file() or name not in names_in(path)
    ]
    assert not missing, "rename or take out of the page: " + ", ".join(missing)


def cells_of(line):
    return [cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]]


def tables(page):
    """Return ``(section, header, rows)`` of each table on a page."""
    section, tables, within = "", [], False
    for line in page.read_text("utf-8").splitlines():
        if line.startswith("#"):
            section = line.lstrip("# ")
        if not line.startswith("|"):
            within = False
        elif not within:
            within = True
            tables.append((section, cells_of(line), []))
        elif set(line) - set("|-: "):
            tables[-1][2].append(cells_of(line))
    return tables


def table(page, *header):
    """Return the rows of the only table on the page with this header."""
    (rows,) = [rows for _, head, rows in tables(page) if head == list(header)]
    return rows


# The least number of table rows with tests on each page: the test must not pass without tables.
LINES = {AGENT: 200, ROBUSTNESS: 70, DOCTOR: 25, INTERFACES: 27, SECURITY: 8, TRANSPORTS: 36,
         CLIENT: 220, ROS2_CASES: 138, ROS2_COMMANDS: 200}  # fmt: skip


WITH_GAPS = (AGENT, CLIENT, ROS2_CASES, ROS2_COMMANDS)


@pytest.mark.parametrize("page", LINES, ids=name_of)
def test_every_line_of_a_table_with_tests_has_its_test(page):
    """Only rows of a missing feature, which begin with "no", have a dash in place of a test."""
    count = 0
    for section, header, rows in tables(page):
        if header[-1] != "test":
            continue
        for cells in rows:
            about = f"{section}: {cells[0]}"
            assert len(cells) == len(header) and all(cells), about
            if page in WITH_GAPS and cells[-1] == "–":
                assert re.match(r"no\b", cells[-2]), about
            else:
                assert all(NAMED.fullmatch(name) for name in cells[-1].split(", ")), about
        count += len(rows)
    assert count >= LINES[page]


@pytest.mark.parametrize("page", LINES, ids=name_of)
def test_no_table_of_a_page_has_a_row_twice(page):
    for section, _, rows in tables(page):
        names = [cells[0] for cells in rows]
        assert len(names) == len(set(names)), section


def test_every_page_is_named_in_the_readme():
    text = README.read_text("utf-8")
    names = [f"docs/{page.name}" for page in (ROOT / "docs").glob("*.md")]
    names += ["docs/design/README.md", "firmware/README.md", "CONTRIBUTING.md", "CHANGELOG.md"]
    assert not [name for name in sorted(names) if name not in text]


def test_the_site_names_every_page_exactly_once():
    """`nav` in mkdocs.yml: a page that it lacks is not on the documentation site."""
    nav = (ROOT / "mkdocs.yml").read_text("utf-8").partition("\nnav:\n")[2]
    named = sorted(re.findall(r"^ +- (?:[^:\n]+: )?([\w/-]+\.md)$", nav, re.M))
    docs = ROOT / "docs"
    pages = {str(page.relative_to(docs)) for page in docs.rglob("*.md")}
    assert named == sorted(pages | {"CHANGELOG.md", "CONTRIBUTING.md"})


# Modules of which programs use no names: helpers of the modules beside them.
INTERNAL = {
    "uros.client.dynamic_messages",
    "uros.client.parameter_services",
    "uros.client.protocols",
    "uros.drivers.sampled",
    "uros.host.background",
    "uros.host.direct",
    "uros.host.interrupt",
    "uros.host.matching",
    "uros.host.no_agent",
    "uros.host.stop_signals",
    "uros.transport.at_modem",
}


def test_every_public_module_of_the_client_is_on_a_page_of_the_api():
    pages = "".join(page.read_text("utf-8") for page in (ROOT / "docs" / "api").glob("*.md"))
    named = {name.rpartition(".")[0] for name in re.findall(r"^::: ([\w.]+)$", pages, re.M)}
    modules = {
        f"uros.{package}.{file.stem}"
        for package in ("client", "transport", "drivers", "host")
        for file in (ROOT / "src" / "uros" / package).glob("*.py")
        if file.stem != "__init__"
    }
    missing = sorted(modules - named - INTERNAL)
    assert not missing, f"a page of docs/api needs '::: {missing[0]}.NAME'"
    assert not named & INTERNAL and modules >= INTERNAL


def test_every_page_of_the_design_is_in_its_index():
    linked = set(re.findall(r"\]\((\w+\.md)\)", HOUSE.read_text("utf-8")))
    assert linked == {page.name for page in HOUSE.parent.glob("*.md")} - {"README.md"}


def test_the_index_of_examples_has_every_program():
    linked = set(re.findall(r"\]\((\w+)/README\.md\)", EXAMPLES.read_text("utf-8")))
    assert linked == {main.parent.name for main in (ROOT / "firmware").glob("*/main.py")}


# --- the packages -----------------------------------------------------------------------------


def test_the_packages_on_the_page_are_those_of_the_tree():
    """The tree on the page has single modules, packages, and one level of packages within them."""
    (house,) = re.findall(r"^src/uros/\n((?:  .*\n)+)", HOUSE.read_text("utf-8"), re.M)
    named, package = [], ""
    for indent, name in re.findall(r"^(  |    )(\w+(?:/|\.py)) ", house, re.M):
        package = package if indent == "    " else name
        named.append(package + name if indent == "    " else name)
    source = ROOT / "src" / "uros"
    existing = {f"{file.parent.name}/" for file in source.glob("*/__init__.py")}
    existing |= {f"{file.parent.relative_to(source)}/" for file in source.glob("*/*/__init__.py")}
    existing |= {file.name for file in source.glob("*.py")} - {"__init__.py", "__main__.py"}
    assert sorted(named) == sorted(existing)


def test_the_import_rules_on_the_page_are_those_that_are_tested():
    allowed = {}
    for rooms, may in table(HOUSE, "package or module", "may import"):
        named = set() if may == "nothing" else set(may.split(", "))
        for room in rooms.split(", "):
            allowed[room] = set(ALLOWED) - {room} if may == "all above" else named
    for room in ("boards", "tools"):  # one row of the table has both
        allowed[room] -= {"boards", "tools"}
    wanted = {room: may - {"boards", "tools"} for room, may in ALLOWED.items()}
    assert allowed == wanted


def test_the_heap_on_the_pages_is_what_its_tests_allow():
    limits = (ROOT / "tests" / "mpy" / "test_memory.py").read_text("utf-8")

    def kilobytes(pattern):
        return f"{int(re.search(pattern + r'([0-9_]+)', limits)[1]) / 1000:g} kB"

    core, running = kilobytes(r'\("core", "mpy"\): '), kilobytes(r"\nRUNNING = ")
    int32, imu = kilobytes(r'"Int32", '), kilobytes(r'"Imu", ')
    page = CLIENT.read_text("utf-8")
    assert f"the client in less than {core} of heap" in page
    assert f"Int32 in less than {int32}, Imu with all it needs in less than {imu}" in page
    assert f"the EK-RA6M5's node in less than {running}" in page
    virtual = (ROOT / "docs" / "virtual_boards.md").read_text("utf-8").replace("\n  ", " ")
    assert f"takes less than {running} as bytecode" in virtual
    stated = {limit: value for limit, value, _ in table(NUMBERS, "what", "value", "where")}
    highest = kilobytes(r"\nHIGH_WATER = ")
    assert stated["a board's heap"] == f"core {core}, RA6M5 node {running}, highest {highest}"


def test_the_numbers_on_the_page_are_those_of_the_sources():
    from uros.agent import watchdog
    from uros.agent.observability import diagnostics
    from uros.agent.persistence import journal, restore, session_store
    from uros.agent.policy import admission, key_conflict, liveliness, time_budget
    from uros.agent.policy.limits import Limits
    from uros.agent.session import session
    from uros.agent.transports import tcp, tls
    from uros.middleware import domains
    from uros.wire.streams import MAX_MESSAGE

    stated = {limit: value for limit, value, _ in table(NUMBERS, "what", "value", "where")}
    limits = Limits()
    assert (time_budget.SHARE_OF_ONE, time_budget.SHARE_OF_ALL, tls.SHARE) == (0.25, 0.5, 0.25)
    for limit, value in (
        ("fragmented message", f"{MAX_MESSAGE >> 20} MiB at most"),
        ("streams of one client; its objects, participants, domains, types",
         f"{session.MAX_STREAMS};"
         f" {limits.objects}, {limits.participants}, {limits.domains}, {limits.types}"),
        ("memory that clients make the agent hold", f"{limits.memory >> 20} MB in all"),
        ("time for creating and deleting", "a quarter for one client, a half for all"),
        ("TCP: connections, of one address; idle without a session",
         f"{tcp.MAX_CONNECTIONS}, {tcp.MAX_FROM_ONE}; {tcp.IDLE_SECONDS:.0f} s"),
        ("TLS handshakes: at once, each, share of the time",
         f"{tls.MAX_HANDSHAKES}, {tls.HANDSHAKE_SECONDS:.0f} s, a quarter"),
        ("the data plane hangs: reported; shutdown hangs: forced",
         f"after {watchdog.HANG_SECONDS:.0f} s; after {watchdog.END_SECONDS:.0f} s"),
        ("state file: clients; journal",
         f"{journal.SLOTS}; {journal.MAX_JOURNAL >> 20} MiB,"
         f" written anew from {session_store.JOURNAL_SIZE >> 20} MiB on"),
        ("a restored writer waits for its readers; a session for its transport",
         f"{restore.HOLD_SECONDS:.0f} s; a day"),
        ("clients; domains", f"{admission.MAX_CLIENTS}; {domains.MAX_JOINED}"),
        ("a silent client: first query; deleted",
         f"after {min(liveliness.DEAD_TIME / 10, 30):.0f} s;"
         f" after {liveliness.DEAD_TIME:.0f} s"),
        ("a client with hard liveliness: query period; deleted",
         f"{liveliness.MIN_HARD_MS / 1000:g} s to an hour; after three queries"),
        ("a second client with the same key waits", f"{sum(key_conflict.WAIT_MS) / 1000:g} s"),
        ("diagnostics: statuses in a message, in a second; a board that left, how many",
         f"{diagnostics.GROUP}, {diagnostics.MAX_RATE};"
         f" {diagnostics.LEFT_SECONDS:.0f} s, {diagnostics.MAX_LEFT}"),
        ("representations kept of one client; answers it does not acknowledge",
         f"{limits.representations >> 20} MiB; {session.MAX_ANSWERS >> 20} MiB"),
    ):  # fmt: skip
        assert stated[limit] == value


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_every_path_that_a_page_names_exists(page):
    """Checked are Python files and paths that begin with a folder of the project or of a package,
    except those with a placeholder in capitals.
    """
    source = ROOT / "src" / "uros"
    places = [ROOT, source, ROOT / "tests", source / "agent", page.parent]
    text = page.read_text("utf-8")
    text = re.sub(r"^```.*?^```$", "", text, flags=re.M | re.S)
    folders = {path.name for place in (ROOT, source) for path in place.iterdir() if path.is_dir()}
    folders.discard("build")  # made by commands
    paths = {path for path in re.findall(r"`([\w.][\w./-]*)`", text) if "/" in path}
    paths = {path for path in paths if not re.search(r"/[A-Z]+(/|$)", path)}
    paths = {
        path for path in paths if re.search(r"\.(py|toml)$", path) or path.split("/")[0] in folders
    }
    missing = [
        path for path in sorted(paths) if not any((place / path).exists() for place in places)
    ]
    assert not missing


def test_the_make_targets_on_the_page_are_those_of_the_makefile():
    makefile = (ROOT / "Makefile").read_text("utf-8")
    (targets,) = re.findall(r"^\.PHONY: (.+)$", makefile, re.M)
    listed = re.findall(r"^\| `make ([\w-]+)` \|", CONTRIBUTING.read_text("utf-8"), re.M)
    assert sorted(listed) == sorted(targets.split())


# --- the command line ---------------------------------------------------------------------------


def parsers():
    """Return the parsers of ``uros agent``, by transport."""
    parser = argparse.ArgumentParser()
    command.add_arguments(parser)
    (transports,) = [
        action for action in parser._actions if isinstance(action, argparse._SubParsersAction)
    ]
    return transports.choices


def options():
    return {
        option
        for parser in parsers().values()
        for action in parser._actions
        for option in action.option_strings
    }


def spelled(text, option):
    """Whether the text has the option, such as ``--port`` or ``-p``."""
    return re.search(rf"(?<![\w-]){re.escape(option)}(?![\w-])", text) is not None


def test_every_option_of_the_agent_is_on_its_page():
    text = "\n".join(re.findall(r"`[^`\n]+`", AGENT.read_text("utf-8")))
    assert not [option for option in sorted(options()) if not spelled(text, option)]
    names = (*parsers(), *command._MIDDLEWARES)
    assert not [name for name in names if not spelled(text, name)]


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_every_option_of_the_agent_on_a_page_exists(page):
    """Checked are all options on the agent's page, and those of ``uros agent …`` on other pages."""
    text = page.read_text("utf-8")
    if page != AGENT:
        text = "\n".join(re.findall(r"`?uros agent (?!-)([^`\n#]*)", text))
    named = set(re.findall(r"(?<![\w-])--[a-z][a-z0-9-]*", text))
    named |= set(re.findall(r"(?:(?<=`)|(?<= ))-[A-Za-z](?= |`|[0-9])", text))
    assert not named - options() - FOREIGN


def test_every_variable_that_the_agent_reads_is_on_its_page():
    source = ROOT / "src" / "uros"
    files = [*(source / "tools").glob("agent*.py")]
    for room in ("agent", "middleware", "transport"):
        files += (source / room).rglob("*.py")
    read = {
        name
        for file in files
        for name in re.findall(r'environ(?:ment)?\.get\("([A-Z_]+)"', file.read_text("utf-8"))
    }
    assert len(read) >= 7
    text = AGENT.read_text("utf-8")
    assert not [name for name in sorted(read) if f"`{name}`" not in text]


def verbs(group=cli._ROOT, name="uros"):
    """Yield ``(words, parser)`` of each command except ``uros agent``, see `parsers`."""
    for word, member in group.members.items():
        if isinstance(member, cli.Group):
            yield from verbs(member, f"{name} {word}")
        elif word != "agent":
            parser = argparse.ArgumentParser()
            import_module(f"uros.tools.{member.module}").add_arguments(parser)
            yield f"{name} {word}", parser
    if group is cli._ROOT:
        yield "uros agent status", parsers()["status"]


VERBS = dict(verbs())


def options_of(verb):
    options = {option for action in VERBS[verb]._actions for option in action.option_strings}
    return options - {"-h", "--help"}


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_every_option_of_a_tool_on_a_page_exists(page):
    """Checked are commands such as ``uros topic echo /x --once``, up to their end."""
    text = page.read_text("utf-8")
    for verb in VERBS:
        for words in re.findall(rf"{verb}(?![\w-])([^`\n#|;&]*)", text):
            used = set(re.findall(r"(?<![\w-])--?[a-z][a-z0-9-]*", words))
            assert not used - options_of(verb) - {"-h", "--help"}, f"{verb}{words}"


@pytest.mark.parametrize(
    ("verb", "page"),
    [
        ("uros agent status", SEEING), ("uros trace", SEEING), ("uros replay", SEEING),
        ("uros doctor", DOCTOR),
    ],
    ids=str,
)  # fmt: skip
def test_every_option_of_a_tool_is_on_its_page(verb, page):
    text = page.read_text("utf-8")
    by_action = [action.option_strings for action in VERBS[verb]._actions if action.option_strings]
    missing = [
        names[0]
        for names in by_action
        if "--help" not in names and not any(spelled(text, name) for name in names)
    ]
    assert not missing


def test_the_defaults_of_the_agent_on_its_page_are_right():
    from uros.agent.policy.admission import MAX_CLIENTS
    from uros.agent.policy.limits import Limits
    from uros.agent.policy.liveliness import DEAD_TIME, MAX_DEAD_TIME
    from uros.tools.agent.options.capture import DEFAULT_SIZE

    def line(option):
        (cells,) = [
            row
            for section, _, rows in tables(AGENT)
            for row in rows
            if section == "Command line" and row[0].startswith(f"`{option} ")
        ]
        return cells[2]

    limits = Limits()
    assert f"{DEAD_TIME:.0f} if not given, at most {MAX_DEAD_TIME:.0f}" in line("--dead-time")
    assert f"{DEFAULT_SIZE} if not given" in line("--capture-size")
    for number in (limits.objects, limits.message, limits.memory >> 20):
        assert re.search(rf"\b{number}\b", line("--max-objects"))
    (clients,) = [
        row[2]
        for section, _, rows in tables(AGENT)
        for row in rows
        if section == "Limits" and row[0] == "clients"
    ]
    assert str(MAX_CLIENTS) in clients


def test_the_default_middleware_is_the_one_on_the_page():
    (line,) = re.findall(r"^\| `-m (\w+)` \(default\)", AGENT.read_text("utf-8"), re.M)
    assert command._common([argparse.Namespace()]).middleware == line


# --- what is shown ------------------------------------------------------------------------------


def test_the_trace_on_the_page_is_printed(capsys):
    (text,) = re.findall(r"^```\n(-- client 0 .+?)^```$", SEEING.read_text("utf-8"), re.M | re.S)
    recording = "tests/captures/rclc_int32_publisher.jsonl"
    assert f"`{recording}`" in SEEING.read_text("utf-8")
    assert cli.main(["trace", str(ROOT / recording)]) == 0
    shown = iter(capsys.readouterr().out.splitlines())
    assert not [line for line in text.splitlines() if line not in shown]  # in this order


def test_the_status_on_the_page_is_printed():
    from uros.tools.agent.status import page

    def board(key, address, nodes, heard, rates, lost):
        return {
            "key": key, "address": address, "nodes": nodes, "heard_ago": heard, "rate_over": 9.6,
            "received": {"lost": lost, "given_up": 0, "rate": rates[0]},
            "sent": {"resent": 0, "rate": rates[1]},
            "queues": {"unacknowledged": 0, "stalled": 0, "early": 0},
        }  # fmt: skip

    snapshot = {
        "pid": 4711, "uptime": 7500, "middleware": "auto", "cpu": 12, "rss": 61_000_000, "fds": 23,
        "transports": [
            {"name": "UDPv4Agent", "label": "port 8888", "messages": 12345, "bytes": 1_200_000},
            {"name": "SerialAgent", "label": "/dev/ttyACM0", "messages": 7, "bytes": 80,
             "crc_errors": 3, "skipped": 120},
        ],
        "clients": [
            board("0x4B0CBE99", "192.168.1.7:2018", [{"name": "/left/board", "domain": 0}], 0,
                  (26.5, 28.7), 0),
            board("0x4B0CBE9A", "192.168.1.9:2018", [{"name": "/imu", "domain": 3}], 0.4,
                  (2.2, 0), 4),
        ],
        "refused": [{"key": "0x4B0CBE99", "address": "192.168.1.8:2018", "times": 12, "ago": 3,
                     "why": "client key in use"}],
    }  # fmt: skip
    (text,) = re.findall(r"^```\n(agent \d+, .+?)^```$", SEEING.read_text("utf-8"), re.M | re.S)
    assert text.splitlines() == page(snapshot, width=10_000)


def test_the_findings_on_the_page_of_the_doctor_are_printed():
    from uros.tools.doctor.agents import check_agents
    from uros.tools.doctor.command import lines
    from uros.tools.doctor.finding import problem

    page = DOCTOR.read_text("utf-8")
    (text,) = re.findall(r"^```\n\$ uros doctor [^\n]*\n(.+?)^```$", page, re.M | re.S)
    findings = [
        check_agents([{"pid": 4242, "clients": [{}]}]),
        problem(
            "permission", "me may not open /dev/ttyACM0: its group is dialout",
            "sudo usermod -aG dialout $USER, then log out and in again",
        ),
        problem(
            "qos", "nothing that /board publishes on /temp reaches /listener: reliability offered"
            " is best_effort, requested reliable",
            "start the agent with --qos /temp:reliability=reliable",
        ),
    ]  # fmt: skip
    assert text == "".join(lines(finding) + "\n" for finding in findings)


def test_the_metrics_on_the_page_are_those_of_the_agent():
    from uros.agent.observability import prometheus

    listed = []
    for names, _, _ in table(SEEING, "metric", "labels", "what it is"):
        stem = ""
        for name in re.findall(r"`([\w…]+)`", names):
            stem = stem if name.startswith("…") else re.match(r"uros_[a-z]+_|", name).group()
            listed.append(name.replace("…_", stem))
    wanted = {"uros_agent_info", "uros_agent_uptime_seconds", "uros_clients",
              "uros_refused_clients", "uros_refusals_total", "uros_client_info",
              "uros_client_silence_seconds", "uros_tls_not_after_timestamp_seconds",
              "uros_transport_connections"}  # fmt: skip
    clients = prometheus._CLIENT
    wanted |= {f"uros_client_{name}{'_total' * counts}" for name, _, counts, _ in clients}
    wanted |= {f"uros_transport_{name}_total" for name, _, _ in prometheus._TRANSPORT}
    assert sorted(listed) == sorted(wanted)
    page = " ".join(SEEING.read_text("utf-8").split())
    assert f"the first {prometheus.MAX_SERIES} share one" in page


def test_the_rules_that_refuse_on_the_page_are_those_of_the_metric():
    from uros.agent.policy.admission import RULES

    listed = [
        (kind.strip("`"), rule)
        for kind, rules, _ in table(PRODUCTION, "`kind`", "`rule`", "refused")
        for rule in re.findall(r"`(\w+)`", rules)
    ]
    assert sorted(listed) == sorted((kind, rule) for kind in RULES for rule in RULES[kind])


def test_the_log_messages_of_tls_on_the_page_are_in_the_sources():
    source = ROOT / "src" / "uros" / "agent" / "transports"
    text = "".join((source / name).read_text("utf-8") for name in ("tls.py", "tcp.py"))
    text = re.sub(r'"\n\s*f?"', "", text)
    text = text.replace("{HANDSHAKE_SECONDS:.0f}", "10")
    messages = [message for message, _ in table(SECURITY, "the log says", "and means")]
    assert not [message for message in messages if message not in text]


@pytest.fixture(scope="module")
def certified(tmp_path_factory):
    """A folder in which the page's commands have created certificates."""
    folder = tmp_path_factory.mktemp("certificates")
    (commands,) = re.findall(r"^```sh\n(.+?)^```$", SECURITY.read_text("utf-8"), re.M | re.S)
    assert shutil.which("openssl"), "this test needs openssl"
    subprocess.run(["sh", "-ec", commands], cwd=folder, check=True, capture_output=True)
    return folder


def test_the_certificates_of_the_page_work_for_agent_and_board(certified):
    from uros.agent.transports.certificates import Certificates

    names = ("agent.pem", "agent.key", "ca.pem")
    files = Certificates(*(str(certified / name) for name in names))
    assert not files.doubt()
    board = ssl.create_default_context(cafile=str(certified / "ca.pem"))
    board.load_cert_chain(certified / "left.pem", certified / "left.key")
    for name in ("robot.local", "192.168.1.20"):
        requests, replies = ssl.MemoryBIO(), ssl.MemoryBIO()
        client = board.wrap_bio(replies, requests, server_hostname=name)
        server = files.context().wrap_bio(requests, replies, server_side=True)
        for _ in range(3):
            for side in (client, server):
                try:
                    side.do_handshake()
                except ssl.SSLWantReadError:
                    pass
        assert ("commonName", "left") in server.getpeercert()["subject"][0]
        assert client.version() in ("TLSv1.2", "TLSv1.3")


# --- links --------------------------------------------------------------------------------------


def anchors(page):
    """Return the anchors of a page: its headings, as GitHub spells them."""
    headings = re.findall(r"^#+ (.+)$", page.read_text("utf-8"), re.M)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_links_have_targets(page):
    for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text("utf-8")):
        if re.match(r"[a-z]+:", target):
            continue
        path, _, anchor = target.partition("#")
        linked = (page.parent / path).resolve() if path else page
        assert linked.exists(), target
        assert not anchor or anchor in anchors(linked), target


# --- rules for clients --------------------------------------------------------------------------


def test_the_rules_on_the_page_have_the_described_effect(tmp_path):
    (text,) = re.findall(r"^```toml\n(.+?)^```$", AGENT.read_text("utf-8"), re.M | re.S)
    file = tmp_path / "rules.toml"
    file.write_text(text)
    rules = Rules()
    assert rules.load(file) == text.count("\n[[client]]") == 4

    def settings(key=1, address="/dev/ttyS0 (1)", node="/n"):
        return rules.settings(key, address, node)

    for key, namespace in ((0x4B0CBE99, "/left"), (0x4B0CBE9A, "/right"), (7, "/right"), (8, "")):
        assert settings(key=key).namespace == namespace
    for address in ("192.168.1.7:2018", "192.168.2.7:2018"):
        client = settings(address=address)
        limits = (100.0, 4096) if ".1.7" in address else (None, None)
        assert (client.max_rate, client.max_size) == limits
    turtle = settings(node="/turtle_2")
    assert turtle.domain == 7 and settings().domain is None
    assert [turtle.name(topic) for topic in ("/cmd_vel", "/image", "/odom")] == [
        "/turtle1/cmd_vel", "/camera/image", "/odom"
    ]  # fmt: skip
    qos = QoSProfile(10)
    turtle.apply(qos, "rt/odom")
    assert qos == QoSProfile(1, ReliabilityPolicy.BEST_EFFORT)


def test_all_names_and_policies_of_rules_are_on_the_page():
    from uros.agent.policy import rules

    text = AGENT.read_text("utf-8").partition("\n## Rules for clients\n")[2]
    words = {*rules.GLOBAL, *rules._SELECTORS, *rules._ACTIONS, *rules._NUMBERS}
    for policy, values in rules._POLICIES.items():
        words |= {policy, *values}
    assert not [word for word in sorted(words) if f"`{word}`" not in text]


GLOSSARY = ROOT / "docs" / "design" / "glossary.md"


@pytest.mark.cyclone
def test_every_class_of_the_glossary_exists():
    wrong, named = [], 0
    for line in GLOSSARY.read_text("utf-8").splitlines():
        if not line.startswith("|"):
            continue
        for module, name in re.findall(r"`(uros(?:\.[a-z_0-9]+)+)\.([A-Z]\w*)`", line):
            named += 1
            try:
                exists = hasattr(importlib.import_module(module), name)
            except ImportError:
                exists = False
            if not exists:
                wrong.append(f"{module}.{name}, in: {line[:60]}")
    assert named > 50 and not wrong, "no such class:\n" + "\n".join(wrong)


def test_the_names_of_code_on_the_page_of_where_to_add_exist():
    """Every constant and class in backquotes is in a file of src."""
    page = (ROOT / "docs" / "design" / "where_to_add.md").read_text("utf-8")
    source = "\n".join(path.read_text("utf-8") for path in (ROOT / "src").rglob("*.py"))
    names = set(re.findall(r"`(_?[A-Z][A-Za-z_]+)`", page))
    missing = [name for name in sorted(names) if not re.search(rf"\b{name}\b", source)]
    assert len(names) > 10 and not missing, f"no such name in src: {', '.join(missing)}"


# --- the configuration file -----------------------------------------------------------------------

PRODUCTION = ROOT / "docs" / "production.md"


def test_the_keys_on_the_page_are_those_of_the_configuration_file():
    from uros.tools.agent.config.schema import tables as tables_of_config

    listed = {
        re.fullmatch(r"`\[(\w+)\]`", name)[1]: re.findall(r"`(\w+)`", keys)
        for name, keys in table(PRODUCTION, "table", "keys")
    }
    known = tables_of_config(command._GROUPS)
    assert listed == {name: list(keys) for name, keys in known.items()}


def test_the_configuration_on_the_page_is_good(tmp_path, capsys):
    from support.certificates import Authority

    text = re.findall(r"^```toml\n(.+?)^```$", PRODUCTION.read_text("utf-8"), re.M | re.S)[0]
    authority = Authority(tmp_path)
    authority.agent()
    authority.revoke()
    path = tmp_path / "agent.toml"
    path.write_text(text.replace("/var/lib/uros", str(tmp_path)))
    status = cli.main(["agent", "check", str(path)])
    lines = capsys.readouterr().out.splitlines()
    # Other programs of this machine may have its ports.
    serious = [line for line in lines[:-1] if "in use" not in line and "ends on" not in line]
    assert (status, serious) == (0, []), lines


def test_the_commands_of_the_page_revoke_the_certificate_of_a_board(certified):
    from uros.agent.transports.certificates import Certificates

    (commands,) = re.findall(
        r"^\*\*Revocation\..+?^```text\n(.+?)^```$", SECURITY.read_text("utf-8"), re.M | re.S
    )
    subprocess.run(["sh", "-ec", commands], cwd=certified, check=True, capture_output=True)
    names = ("agent.pem", "agent.key", "ca.pem", "crl.pem")
    files = Certificates(*(str(certified / name) for name in names))
    assert len(files.doubts(0.0)) == 3  # nothing was valid in 1970

    def is_revoked(name):
        pem = (certified / f"{name}.pem").read_text()
        return files.is_revoked(ssl.PEM_cert_to_DER_cert(pem))

    assert is_revoked("left") and not is_revoked("agent")


def test_the_figures_on_the_page_are_those_of_the_page_about_performance():
    text = (ROOT / "docs" / "performance.md").read_text("utf-8")
    page = PRODUCTION.read_text("utf-8").partition("\n## Sizing\n")[2]
    figures = re.findall(r"\d+(?:\.\d+)? (?:MB|kB|core|ms|µs)(?= \||,)", page)
    assert len(figures) >= 9
    assert not [figure for figure in figures if figure not in text]
    assert "31 kB | 27 kB | 26 kB" in text


def test_the_sizes_of_files_on_the_page_are_those_of_the_sources():
    from uros.agent.persistence import journal
    from uros.tools.agent.options import audit, capture

    sizes = dict(table(PRODUCTION, "file", "size"))
    assert sizes["state"] == f"0.5 MB, and a journal of at most {journal.MAX_JOURNAL >> 20} MB"
    assert sizes["capture"].startswith(f"two files of {capture.DEFAULT_SIZE} MB")
    assert sizes["audit"].startswith(f"two files of {audit.DEFAULT_SIZE} MB")
