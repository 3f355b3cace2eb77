"""What the pages say is there: the tests they name, the options, the links, the example."""

import argparse
import ast
import re
from functools import lru_cache
from pathlib import Path

import pytest

from uros.agent.control import Control
from uros.qos import QoSProfile, ReliabilityPolicy
from uros.tools import agent

ROOT = Path(__file__).resolve().parents[2]
PAGES = [
    *(ROOT / name for name in ("README.md", "ARCHITECTURE.md", "CONTRIBUTING.md")),
    *sorted((ROOT / "docs").glob("*.md")),
]
AGENT = ROOT / "docs" / "agent.md"
ROBUSTNESS = ROOT / "docs" / "robustness.md"
NAMED = re.compile(r"`([\w/.]+\.py)::(\w+)`")

# Options on the page of the agent that are not its own.
FOREIGN = {"--ros-args"}


def name_of(page):
    return page.name


@lru_cache
def names_in(path):
    """The names of the test functions of a file."""
    tree = ast.parse((ROOT / "tests" / path).read_text("utf-8"))
    return {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}


# --- tests ------------------------------------------------------------------------------------


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_every_test_that_a_page_names_exists(page):
    missing = [
        f"{path}::{name}"
        for path, name in NAMED.findall(page.read_text("utf-8"))
        if not (ROOT / "tests" / path).is_file() or name not in names_in(path)
    ]
    assert not missing, "rename or take out of the page: " + ", ".join(missing)


def rows():
    """``(section, cells)`` of the tables on the page of the agent that name tests."""
    section, within = "", False
    for line in AGENT.read_text("utf-8").splitlines():
        if line.startswith("#"):
            section = line.lstrip("# ")
        if not line.startswith("|"):
            within = False
            continue
        cells = [it.strip() for it in re.split(r"(?<!\\)\|", line)[1:-1]]
        if cells[-1] == "test":
            within = True
        elif within and set(cells[0]) != {"-"}:
            yield section, cells


def test_every_line_about_the_agent_has_its_test():
    """But those that say what it does not do: "no", to begin with."""
    lines = list(rows())
    assert len(lines) > 150
    for section, cells in lines:
        about = f"{section}: {cells[0]}"
        assert len(cells) == 4 and all(cells), about
        if cells[3] == "–":
            assert re.match(r"no\b", cells[2]), about
        else:
            assert all(NAMED.fullmatch(it) for it in cells[3].split(", ")), about


def test_every_attack_on_the_page_has_its_test():
    lines = [
        [it.strip() for it in re.split(r"(?<!\\)\|", line)[1:-1]]
        for line in ROBUSTNESS.read_text("utf-8").splitlines()
        if line.startswith("|")
    ]
    lines = [it for it in lines if it[0] != "attack or fault" and set(it[0]) != {"-"}]
    assert len(lines) > 70
    for cells in lines:
        assert len(cells) == 3 and all(cells), cells[0]
        assert all(NAMED.fullmatch(it) for it in cells[2].split(", ")), cells[0]


# --- the command line ---------------------------------------------------------------------------


def parsers():
    """The parsers of ``uros agent``, by transport."""
    parser = argparse.ArgumentParser()
    agent.add_arguments(parser)
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
    assert not [it for it in (*parsers(), *agent._MIDDLEWARES) if not spelled(text, it)]


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


def test_the_default_middleware_is_the_one_on_the_page():
    (line,) = re.findall(r"^\| `-m (\w+)` \(default\)", AGENT.read_text("utf-8"), re.M)
    assert agent._common([argparse.Namespace()]).middleware == line


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
    control = Control()
    assert control.load(file) == text.count("\n[[client]]") == 4

    def settings(key=1, address="/dev/ttyS0 (1)", node="/n"):
        return control.settings(key, address, node)

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
    from uros.agent import control

    text = AGENT.read_text("utf-8").partition("\n## Rules for clients\n")[2]
    words = {*control.GLOBAL, *control._SELECTORS, *control._ACTIONS, *control._NUMBERS}
    for policy, values in control._POLICIES.items():
        words |= {policy, *values}
    assert not [word for word in sorted(words) if f"`{word}`" not in text]
