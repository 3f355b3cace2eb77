"""What the pages say is there: tests, options, files, links, metrics, lines of output, commands."""

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
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")),
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
NAMED = re.compile(r"`([\w/.]+\.py)::(\w+)`")

# Options on the page of the agent that are not its own.
FOREIGN = {"--ros-args"}


def name_of(page):
    return str(page.relative_to(ROOT))


@lru_cache
def names_in(path):
    """The names of the test functions of a file."""
    tree = ast.parse((ROOT / "tests" / path).read_text("utf-8"))
    return {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}


@lru_cache
def happenings():
    """All that can be made to happen to a virtual board, without values."""
    found = set()
    for name in BOARDS:
        board = VirtualBoard(find(name), ManualClock(), plugs=["esp8266:uart=7", "wlan"])
        try:
            found |= {it.spec for it in (*board.acts(), *board.faults())}
        finally:
            board.close()
    names = {it.partition(":")[0] for it in found}
    return found | {f"{it}:off" for it in (*names, "all")}, names


@pytest.mark.parametrize(
    "page",
    [
        README,
        *(ROOT / "docs" / f"{it}.md" for it in ("boards", "virtual_boards")),
        *sorted((ROOT / "firmware").rglob("README.md")),
    ],
    ids=name_of,
)
def test_what_a_page_makes_happen_to_boards_can_happen_and_the_boards_exist(page):
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
    return [it.strip() for it in re.split(r"(?<!\\)\|", line)[1:-1]]


def tables(page):
    """``(section, header, rows)`` of each table on a page."""
    section, found, within = "", [], False
    for line in page.read_text("utf-8").splitlines():
        if line.startswith("#"):
            section = line.lstrip("# ")
        if not line.startswith("|"):
            within = False
        elif not within:
            within = True
            found.append((section, cells_of(line), []))
        elif set(line) - set("|-: "):
            found[-1][2].append(cells_of(line))
    return found


def table(page, *header):
    """The rows of the one table on the page with this header."""
    (rows,) = [rows for _, head, rows in tables(page) if head == list(header)]
    return rows


# How many lines the pages have that name tests, at least: a table that is not found proves nothing.
LINES = {AGENT: 200, ROBUSTNESS: 70, DOCTOR: 25, INTERFACES: 27, SECURITY: 8, TRANSPORTS: 36,
         CLIENT: 220}  # fmt: skip


@pytest.mark.parametrize("page", LINES, ids=name_of)
def test_every_line_of_a_table_with_tests_has_its_test(page):
    """But those that say what agent or client does not do: "no", to begin with."""
    count = 0
    for section, header, rows in tables(page):
        if header[-1] != "test":
            continue
        for cells in rows:
            about = f"{section}: {cells[0]}"
            assert len(cells) == len(header) and all(cells), about
            if page in (AGENT, CLIENT) and cells[-1] == "–":
                assert re.match(r"no\b", cells[-2]), about
            else:
                assert all(NAMED.fullmatch(it) for it in cells[-1].split(", ")), about
        count += len(rows)
    assert count >= LINES[page]


@pytest.mark.parametrize("page", LINES, ids=name_of)
def test_no_table_of_a_page_says_a_thing_twice(page):
    for section, _, rows in tables(page):
        names = [cells[0] for cells in rows]
        assert len(names) == len(set(names)), section


def test_every_page_is_named_where_people_begin():
    text = README.read_text("utf-8")
    names = [f"docs/{page.name}" for page in (ROOT / "docs").glob("*.md")]
    names += ["docs/design/README.md", "firmware/README.md", "CONTRIBUTING.md", "CHANGELOG.md"]
    assert not [it for it in sorted(names) if it not in text]


def test_every_page_of_the_design_is_in_its_index():
    linked = set(re.findall(r"\]\((\w+\.md)\)", HOUSE.read_text("utf-8")))
    assert linked == {page.name for page in HOUSE.parent.glob("*.md")} - {"README.md"}


def test_the_index_of_examples_has_every_program():
    linked = set(re.findall(r"\]\((\w+)/README\.md\)", EXAMPLES.read_text("utf-8")))
    assert linked == {main.parent.name for main in (ROOT / "firmware").glob("*/main.py")}


# --- the house --------------------------------------------------------------------------------


def test_the_packages_on_the_page_are_those_of_the_tree():
    """Single modules beside them, and one level of packages within them."""
    (house,) = re.findall(r"^src/uros/\n((?:  .*\n)+)", HOUSE.read_text("utf-8"), re.M)
    named, package = [], ""
    for indent, name in re.findall(r"^(  |    )(\w+(?:/|\.py)) ", house, re.M):
        package = package if indent == "    " else name
        named.append(package + name if indent == "    " else name)
    source = ROOT / "src" / "uros"
    there = {f"{it.parent.name}/" for it in source.glob("*/__init__.py")}
    there |= {f"{it.parent.relative_to(source)}/" for it in source.glob("*/*/__init__.py")}
    there |= {it.name for it in source.glob("*.py")} - {"__init__.py", "__main__.py"}
    assert sorted(named) == sorted(there)


def test_the_walls_on_the_page_are_those_that_are_tested():
    told = {}
    for rooms, may in table(HOUSE, "room", "may import"):
        named = set() if may == "nothing" else set(may.split(", "))
        for room in rooms.split(", "):
            told[room] = set(ALLOWED) - {room} if may == "all above" else named
    for room in ("boards", "tools"):  # each of them is in the same line as the other
        told[room] -= {"boards", "tools"}
    wanted = {room: may - {"boards", "tools"} for room, may in ALLOWED.items()}
    assert told == wanted


def test_the_numbers_on_the_page_are_those_of_the_sources():
    from uros.agent import watchdog
    from uros.agent.persistence import journal, restore, session_store
    from uros.agent.policy import admission, key_conflict, liveliness, time_budget
    from uros.agent.policy.limits import Limits
    from uros.agent.session import session
    from uros.agent.transports import tcp, tls
    from uros.wire.streams import MAX_MESSAGE

    told = {what: value for what, value, _ in table(NUMBERS, "what", "value", "where")}
    it = Limits()
    assert (time_budget.SHARE_OF_ONE, time_budget.SHARE_OF_ALL, tls.SHARE) == (0.25, 0.5, 0.25)
    for what, value in (
        ("fragmented message", f"{MAX_MESSAGE >> 20} MiB at most"),
        ("streams of one client; its objects, participants, domains, types",
         f"{session.MAX_STREAMS}; {it.objects}, {it.participants}, {it.domains}, {it.types}"),
        ("memory that clients make the agent hold", f"{it.memory >> 20} MB in all"),
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
        ("clients; domains", f"{admission.MAX_CLIENTS}; 32"),
        ("a silent client: first query; deleted",
         f"after {min(liveliness.DEAD_TIME / 10, 30):.0f} s;"
         f" after {liveliness.DEAD_TIME:.0f} s"),
        ("a client with hard liveliness: query period; deleted",
         f"{liveliness.MIN_HARD_MS / 1000:g} s to an hour; after three queries"),
        ("a second client with the same key waits", f"{sum(key_conflict.WAIT_MS) / 1000:g} s"),
        ("representations kept of one client; answers it does not acknowledge",
         f"{it.representations >> 20} MiB; {session.MAX_ANSWERS >> 20} MiB"),
    ):  # fmt: skip
        assert told[what] == value


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_every_path_that_a_page_names_exists(page):
    """Files of Python, and whatever begins with a folder of the project or of a package; not
    where a word in capitals stands for many.
    """
    source = ROOT / "src" / "uros"
    places = [ROOT, source, ROOT / "tests", source / "agent", page.parent]
    text = page.read_text("utf-8")
    text = re.sub(r"^```.*?^```$", "", text, flags=re.M | re.S)
    folders = {it.name for place in (ROOT, source) for it in place.iterdir() if it.is_dir()}
    named = {it for it in re.findall(r"`([\w./-]+)`", text) if "/" in it}
    named = {it for it in named if not re.search(r"/[A-Z]+(/|$)", it)}
    named = {it for it in named if re.search(r"\.(py|toml)$", it) or it.split("/")[0] in folders}
    missing = [it for it in sorted(named) if not any((place / it).exists() for place in places)]
    assert not missing


def test_what_make_does_is_what_the_page_says():
    makefile = (ROOT / "Makefile").read_text("utf-8")
    (targets,) = re.findall(r"^\.PHONY: (.+)$", makefile, re.M)
    told = re.findall(r"^\| `make ([\w-]+)` \|", CONTRIBUTING.read_text("utf-8"), re.M)
    assert sorted(told) == sorted(targets.split())


# --- the command line ---------------------------------------------------------------------------


def parsers():
    """The parsers of ``uros agent``, by transport."""
    parser = argparse.ArgumentParser()
    command.add_arguments(parser)
    (transports,) = [it for it in parser._actions if isinstance(it, argparse._SubParsersAction)]
    return transports.choices


def options():
    return {
        option
        for parser in parsers().values()
        for action in parser._actions
        for option in action.option_strings
    }


def spelled(text, option):
    """Whether the page has the option, as ``--port``, or in code as ``-p``."""
    return re.search(rf"(?<![\w-]){re.escape(option)}(?![\w-])", text) is not None


def test_every_option_of_the_agent_is_on_its_page():
    text = "\n".join(re.findall(r"`[^`\n]+`", AGENT.read_text("utf-8")))
    assert not [it for it in sorted(options()) if not spelled(text, it)]
    assert not [it for it in (*parsers(), *command._MIDDLEWARES) if not spelled(text, it)]


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_every_option_of_the_agent_on_a_page_exists(page):
    """On the agent's own page that is every option, elsewhere those of ``uros agent …``."""
    text = page.read_text("utf-8")
    if page != AGENT:
        text = "\n".join(re.findall(r"`?uros agent (?!-)([^`\n#]*)", text))
    found = set(re.findall(r"(?<![\w-])--[a-z][a-z0-9-]*", text))
    found |= {it for it in re.findall(r"(?:(?<=`)|(?<= ))-[A-Za-z](?= |`|[0-9])", text)}
    assert not found - options() - FOREIGN


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
    """``(words, parser)`` of each command but ``uros agent``, which has parsers of its own."""
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
    found = {option for it in VERBS[verb]._actions for option in it.option_strings}
    return found - {"-h", "--help"}


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_every_option_of_a_tool_on_a_page_exists(page):
    """In commands, ``uros topic echo /x --once``, as long as nothing else begins."""
    text = page.read_text("utf-8")
    for verb in VERBS:
        for said in re.findall(rf"{verb}(?![\w-])([^`\n#|;&]*)", text):
            used = set(re.findall(r"(?<![\w-])--?[a-z][a-z0-9-]*", said))
            assert not used - options_of(verb) - {"-h", "--help"}, f"{verb}{said}"


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
    by_action = [it.option_strings for it in VERBS[verb]._actions if it.option_strings]
    missing = [
        names[0]
        for names in by_action
        if "--help" not in names and not any(spelled(text, it) for it in names)
    ]
    assert not missing


def test_the_defaults_of_the_agent_on_its_page_are_those_it_has():
    from uros.agent.policy.admission import MAX_CLIENTS
    from uros.agent.policy.limits import Limits
    from uros.agent.policy.liveliness import DEAD_TIME, MAX_DEAD_TIME
    from uros.tools.agent.options.capture import DEFAULT_SIZE

    def line(option):
        (cells,) = [
            it
            for section, _, rows in tables(AGENT)
            for it in rows
            if section == "Command line" and it[0].startswith(f"`{option} ")
        ]
        return cells[2]

    limits = Limits()
    assert f"{DEAD_TIME:.0f} if not given, at most {MAX_DEAD_TIME:.0f}" in line("--dead-time")
    assert f"{DEFAULT_SIZE} if not given" in line("--capture-size")
    for number in (limits.objects, limits.message, limits.memory >> 20):
        assert re.search(rf"\b{number}\b", line("--max-objects"))
    (clients,) = [
        it[2]
        for section, _, rows in tables(AGENT)
        for it in rows
        if section == "Limits" and it[0] == "clients"
    ]
    assert str(MAX_CLIENTS) in clients


def test_the_default_middleware_is_the_one_on_the_page():
    (line,) = re.findall(r"^\| `-m (\w+)` \(default\)", AGENT.read_text("utf-8"), re.M)
    assert command._common([argparse.Namespace()]).middleware == line


# --- what is shown ------------------------------------------------------------------------------


def test_the_trace_on_the_page_is_what_it_shows(capsys):
    (text,) = re.findall(r"^```\n(-- client 0 .+?)^```$", SEEING.read_text("utf-8"), re.M | re.S)
    recording = "tests/captures/rclc_int32_publisher.jsonl"
    assert f"`{recording}`" in SEEING.read_text("utf-8")
    assert cli.main(["trace", str(ROOT / recording)]) == 0
    shown = iter(capsys.readouterr().out.splitlines())
    assert not [line for line in text.splitlines() if line not in shown]  # in this order


def test_the_page_of_status_is_how_it_looks():
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


def test_the_findings_on_the_page_of_the_doctor_are_how_they_look():
    from uros.tools.doctor.agents import check_agents
    from uros.tools.doctor.command import lines
    from uros.tools.doctor.finding import problem

    page = DOCTOR.read_text("utf-8")
    (text,) = re.findall(r"^```\n\$ uros doctor [^\n]*\n(.+?)^```$", page, re.M | re.S)
    found = [
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
    assert text == "".join(lines(it) + "\n" for it in found)


def test_every_metric_is_on_the_page_and_no_other():
    from uros.agent.observability import prometheus

    told = []
    for names, _, _ in table(SEEING, "metric", "labels", "what it is"):
        stem = ""
        for name in re.findall(r"`([\w…]+)`", names):
            stem = stem if name.startswith("…") else re.match(r"uros_[a-z]+_|", name).group()
            told.append(name.replace("…_", stem))
    wanted = {"uros_agent_info", "uros_agent_uptime_seconds", "uros_clients",
              "uros_refused_clients", "uros_client_info", "uros_client_silence_seconds",
              "uros_transport_connections"}  # fmt: skip
    clients = prometheus._CLIENT
    wanted |= {f"uros_client_{name}{'_total' * counts}" for name, _, counts, _ in clients}
    wanted |= {f"uros_transport_{name}_total" for name, _, _ in prometheus._TRANSPORT}
    assert sorted(told) == sorted(wanted)
    page = " ".join(SEEING.read_text("utf-8").split())
    assert f"the first {prometheus.MAX_SERIES} share one" in page


def test_what_the_log_says_of_tls_is_in_the_sources():
    source = ROOT / "src" / "uros" / "agent" / "transports"
    said = "".join((source / name).read_text("utf-8") for name in ("tls.py", "tcp.py"))
    said = re.sub(r'"\n\s*f?"', "", said)
    said = said.replace("{HANDSHAKE_SECONDS:.0f}", "10")
    assert not [it for it, _ in table(SECURITY, "the log says", "and means") if it not in said]


@pytest.fixture(scope="module")
def certified(tmp_path_factory):
    """A folder in which the commands of the page were run."""
    folder = tmp_path_factory.mktemp("certificates")
    (commands,) = re.findall(r"^```sh\n(.+?)^```$", SECURITY.read_text("utf-8"), re.M | re.S)
    assert shutil.which("openssl"), "this test needs openssl"
    subprocess.run(["sh", "-ec", commands], cwd=folder, check=True, capture_output=True)
    return folder


def test_the_certificates_of_the_page_are_good_for_agent_and_board(certified):
    from uros.agent.transports.certificates import Certificates

    files = Certificates(*(str(certified / it) for it in ("agent.pem", "agent.key", "ca.pem")))
    assert not files.doubt()
    board = ssl.create_default_context(cafile=str(certified / "ca.pem"))
    board.load_cert_chain(certified / "left.pem", certified / "left.key")
    for name in ("robot.local", "192.168.1.20"):
        there, back = ssl.MemoryBIO(), ssl.MemoryBIO()
        asking = board.wrap_bio(back, there, server_hostname=name)
        answering = files.context().wrap_bio(there, back, server_side=True)
        for _ in range(3):
            for side in (asking, answering):
                try:
                    side.do_handshake()
                except ssl.SSLWantReadError:
                    pass
        assert ("commonName", "left") in answering.getpeercert()["subject"][0]
        assert asking.version() in ("TLSv1.2", "TLSv1.3")


# --- links --------------------------------------------------------------------------------------


def anchors(page):
    """What links into a page may name: its headings, as GitHub spells them."""
    headings = re.findall(r"^#+ (.+)$", page.read_text("utf-8"), re.M)
    return {re.sub(r"[^\w\- ]", "", it.lower()).replace(" ", "-") for it in headings}


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_links_lead_somewhere(page):
    for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text("utf-8")):
        if re.match(r"[a-z]+:", target):
            continue
        path, _, anchor = target.partition("#")
        there = (page.parent / path).resolve() if path else page
        assert there.exists(), target
        assert not anchor or anchor in anchors(there), target


# --- rules for clients --------------------------------------------------------------------------


def test_the_rules_of_the_page_do_what_it_says(tmp_path):
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
        one = settings(address=address)
        limits = (100.0, 4096) if ".1.7" in address else (None, None)
        assert (one.max_rate, one.max_size) == limits
    turtle = settings(node="/turtle_2")
    assert turtle.domain == 7 and settings().domain is None
    assert [turtle.name(it) for it in ("/cmd_vel", "/image", "/odom")] == [
        "/turtle1/cmd_vel", "/camera/image", "/odom"
    ]  # fmt: skip
    qos = QoSProfile(10)
    turtle.apply(qos, "rt/odom")
    assert qos == QoSProfile(1, ReliabilityPolicy.BEST_EFFORT)


def test_names_and_policies_on_the_page_are_all_there_are():
    from uros.agent.policy import rules

    text = AGENT.read_text("utf-8").partition("\n## Rules for clients\n")[2]
    words = {*rules.GLOBAL, *rules._SELECTORS, *rules._ACTIONS, *rules._NUMBERS}
    for policy, values in rules._POLICIES.items():
        words |= {policy, *values}
    assert not [word for word in sorted(words) if f"`{word}`" not in text]


GLOSSARY = ROOT / "docs" / "design" / "glossary.md"


def test_every_class_of_the_glossary_exists():
    wrong, named = [], 0
    for line in GLOSSARY.read_text("utf-8").splitlines():
        if not line.startswith("|"):
            continue
        for module, name in re.findall(r"`(uros(?:\.[a-z_0-9]+)+)\.([A-Z]\w*)`", line):
            named += 1
            try:
                found = hasattr(importlib.import_module(module), name)
            except ImportError:
                found = False
            if not found:
                wrong.append(f"{module}.{name}, in: {line[:60]}")
    assert named > 50 and not wrong, "no such class:\n" + "\n".join(wrong)


def test_the_names_of_code_on_the_page_of_where_to_add_exist():
    """Constants and classes in backquotes: a reader looks for them in the file that is named."""
    page = (ROOT / "docs" / "design" / "where_to_add.md").read_text("utf-8")
    source = "\n".join(path.read_text("utf-8") for path in (ROOT / "src").rglob("*.py"))
    names = set(re.findall(r"`(_?[A-Z][A-Za-z_]+)`", page))
    gone = [name for name in sorted(names) if not re.search(rf"\b{name}\b", source)]
    assert len(names) > 10 and not gone, f"no such name in src: {', '.join(gone)}"
