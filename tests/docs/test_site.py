"""The documentation site: it builds strictly, and has the pages that are made at build time."""

import re
import shutil
import subprocess
import sys
from argparse import SUPPRESS

import pytest
from support.paths import ROOT
from unit.test_docs import VERBS, options_of, parsers

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        sys.version_info < (3, 11, 5), reason="not on this platform: mkdocs-material is for 3.11.5"
    ),
]


def build(root, folder):
    """Build the site as ``make docs`` does; return the finished process."""
    return subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)],
        cwd=root, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
    )  # fmt: skip


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    folder = tmp_path_factory.mktemp("site")
    done = build(ROOT, folder)
    assert done.returncode == 0, done.stdout
    return folder


def text_of(page):
    return page.read_text("utf-8")


def test_the_site_has_each_page_of_docs(site):
    pages = [path.relative_to(ROOT / "docs") for path in (ROOT / "docs").rglob("*.md")]
    names = [str(page.with_suffix(".html")).replace("README.html", "index.html") for page in pages]
    assert not [name for name in names if not (site / name).is_file()]


def test_the_commands_have_every_option_of_their_parsers(site):
    missing = []
    for words in VERBS:
        page = text_of(site / "commands" / f"{words.split()[1]}.html")
        hidden = {o for a in VERBS[words]._actions if a.help == SUPPRESS for o in a.option_strings}
        shown = options_of(words) - hidden
        missing += [(words, option) for option in shown if f">{option}" not in page]
    page = text_of(site / "commands" / "agent.html")
    for name, parser in parsers().items():
        assert f"uros agent {name}" in page
        for action in parser._actions:
            if action.help != SUPPRESS and "--help" not in action.option_strings:
                missing += [(name, o) for o in action.option_strings if f">{o}" not in page]
    assert not missing


def test_options_of_all_transports_are_listed_once(site):
    page = text_of(site / "commands" / "agent.html")
    assert page.count("<dt><code>-m NAME</code>") == 1


def test_the_commands_show_no_hidden_option(site):
    assert "--stop-at-eof" not in text_of(site / "commands" / "agent.html")


def test_each_example_has_its_page_with_its_program(site):
    for main in (ROOT / "firmware").glob("*/main.py"):
        page = text_of(site / "firmware" / main.parent.name / "index.html")
        assert 'id="mainpy"' in page, main


def test_links_to_files_outside_of_docs_lead_to_their_pages(site):
    assert 'href="firmware/index.html"' in text_of(site / "boards.html")
    code = "../src/uros/middleware/cyclonedds_uri.py.html"
    assert f'href="{code}"' in text_of(site / "design" / "rtps.html")
    assert "CYCLONEDDS_URI" in text_of(site / "design" / code)


def test_the_api_has_the_text_of_docstrings_and_links_between_them(site):
    page = text_of(site / "api" / "client.html")
    assert "Names follow rclpy, the executor's rules rclc." in page
    assert 'href="client_modules.html#uros.client.remap.Remap"' in page
    assert ":class:" not in page and "on_lost" not in page


def test_long_names_in_tables_may_break(site):
    page = text_of(site / "client.html")
    assert "<code>rclc_<wbr>support_<wbr>init</code>" in page
    assert "<wbr>" not in re.sub(r"<td.*?</td>", "", page, flags=re.S)


def test_the_site_loads_nothing_from_other_servers(site):
    for page in site.rglob("*.html"):
        loaded = re.findall(
            r'<(?:link|script|img)[^>]+(?:href|src)="(https?:[^"]+)"', text_of(page)
        )
        assert not loaded, page


@pytest.mark.slow
@pytest.mark.parametrize(
    ("link", "error"),
    [
        ("[a](nowhere.md)", "'nowhere.md', but the target is not found"),
        ("[a](agent.md#nowhere)", "does not contain an anchor '#nowhere'"),
        ("[a](../firmware/nowhere.md)", "'../firmware/nowhere.md', but the target is not found"),
        ("[a](../CONTRIBUTING.md#nowhere)", "does not contain an anchor '#nowhere'"),
    ],
)
def test_a_broken_link_or_anchor_fails(tmp_path, link, error):
    root = tmp_path / "clone"
    root.mkdir()
    for name in ("mkdocs.yml", "README.md", "CONTRIBUTING.md", "CHANGELOG.md"):
        shutil.copy(ROOT / name, root)
    for name in ("docs", "scripts", "firmware", "src"):
        shutil.copytree(ROOT / name, root / name, ignore=shutil.ignore_patterns("__pycache__"))
    with (root / "docs" / "services.md").open("a") as page:
        page.write(f"\n{link}\n")
    done = build(root, tmp_path / "site")
    assert done.returncode != 0 and error in done.stdout, done.stdout
