"""The commands and programs of the tutorial and how-to pages do what the pages say."""

import re

import pytest
from support.pages import DOCS, blocks_of, pages_of_nav
from support.paths import ROOT
from support.reader import Reader, matches

# The page of the client is a reference that begins with programs.
PAGES = [*pages_of_nav("Tutorial", "How-to"), DOCS / "client.md"]
# The first page that a reader meets. The others take minutes together.
FAST = {"first_board.md"}


def name_of(page):
    return str(page.relative_to(DOCS))


def page_of(page):
    marks = () if page.name in FAST else pytest.mark.slow
    return pytest.param(page, id=name_of(page), marks=marks)


@pytest.mark.timeout(900)
@pytest.mark.parametrize("page", [page_of(page) for page in PAGES])
def test_the_blocks_of_a_page_do_what_it_says(page, tmp_path, own_domain_id):
    Reader(tmp_path, own_domain_id).follow(blocks_of(page.read_text("utf-8")))


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_the_tutorial_works_on_micropython_too(tmp_path, own_domain_id):
    page = DOCS / "tutorial" / "first_board.md"
    reader = Reader(tmp_path, own_domain_id, engine="micropython")
    reader.follow(blocks_of(page.read_text("utf-8")))


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_every_marker_that_a_block_is_not_run_has_a_reason(page):
    for block in blocks_of(page.read_text("utf-8")):
        reason = block.marker("not run")
        assert reason is None or len(reason.split()) >= 4, f"line {block.line}: why not?"
        tests = re.findall(r"[\w/]+\.py", reason or "")
        missing = [name for name in tests if not (ROOT / "tests" / name).is_file()]
        assert not missing, f"line {block.line}: there is no test {missing[0]}"


def test_a_block_of_another_language_is_output_or_has_a_marker():
    """A language that no test runs, such as C, needs a marker too."""
    for page in PAGES:
        text = page.read_text("utf-8")
        for fence in re.finditer(r"((?:^ *<!--[^\n]*-->\n)*)^ *```(\w+)", text, re.M):
            known = fence[2] in ("sh", "python", "text", "toml", "xml", "ini", "yaml", "json")
            assert known or "<!-- not run: " in fence[1], f"{name_of(page)}: {fence[0]}"


def test_there_are_blocks_that_are_run():
    blocks = [block for page in PAGES for block in blocks_of(page.read_text("utf-8"))]
    run = [b for b in blocks if b.kind in ("shell", "python") and b.marker("not run") is None]
    assert len(PAGES) >= 15 and len(run) >= 60


def test_expected_lines_may_differ_in_numbers_only():
    said = ["data: 12", "---", "rate:  9.98 Hz", "key 0x4B0CBE99 at /dev/x"]
    assert matches("data: 7\nrate: 10 Hz\n", said)
    assert matches("key 0x12AB at …\n", said)
    assert not matches("rate: 10 Hz\ndata: 7\n", said)
    assert not matches("data: seven\n", said)
