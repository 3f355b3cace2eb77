"""Hooks of mkdocs: pages that are made at build time, and links to files outside of docs/.

A link in docs/ may lead to any file of the repository, as on a code host. On the site that file is
a page of its own: a Markdown page as it is, any other file as a page with its text, a folder as its
README.md or the text of its `__init__.py`. The example programs of firmware/ and the commands are
pages too, and take the places `firmware/*` and `commands/*` in nav.
"""

import posixpath
import re
from pathlib import Path

import site_commands
from mkdocs.structure.files import File

ROOT = Path(__file__).resolve().parent.parent
DOCS = "docs/"
FENCE = re.compile(r"^ *```.*?^ *```$", re.M | re.S)
LINK = re.compile(r"\]\(([^)\s#]+)(#[^)\s]*)?\)")
CELL = re.compile(r"<td.*?</td>", re.S)
CODE = re.compile(r"(?<=<code>)[^<]+")
# Pages outside of docs/ that nav names.
NAMED = ("CHANGELOG.md", "CONTRIBUTING.md")
# The first page of the repository; the site has a first page of its own.
README = ("README.md", "repository.md")


def origin(uri: str) -> str:
    """The path in the repository of a page of the site."""
    if (ROOT / DOCS / uri).is_file():
        return DOCS + uri
    if uri == README[1]:
        return README[0]
    return uri if (ROOT / uri).is_file() else uri.removesuffix(".md")


def address(path: str) -> str:
    """The page of the site that has a file or folder of the repository."""
    if (ROOT / path).is_dir():
        names = ("README.md", "__init__.py")
        path = next(f"{path}/{name}" for name in names if (ROOT / path / name).is_file())
    if path == README[0]:
        return README[1]
    if path.startswith(DOCS):
        return path.removeprefix(DOCS)
    return path if path.endswith(".md") else path + ".md"


def targets(text: str, path: str) -> set:
    """The files and folders of the repository that the page at ``path`` links to."""
    base = posixpath.dirname(path)
    links = [link for link, _ in LINK.findall(FENCE.sub("", text)) if ":" not in link]
    return {posixpath.normpath(posixpath.join(base, link)) for link in links}


def with_links_of_the_site(text: str, uri: str) -> str:
    """The text of a page whose links to files of the repository lead to their pages."""
    path = origin(uri)

    def replaced(match: re.Match) -> str:
        link, anchor = match[1], match[2] or ""
        target = posixpath.normpath(posixpath.join(posixpath.dirname(path), link))
        if ":" in link or not (ROOT / target).exists():
            return match[0]  # mkdocs reports links without a target
        to = posixpath.relpath(address(target), posixpath.dirname(uri) or ".")
        return f"]({to}{anchor})"

    pieces, at = [], 0
    for fence in FENCE.finditer(text):
        pieces += [LINK.sub(replaced, text[at : fence.start()]), fence[0]]
        at = fence.end()
    return "".join([*pieces, LINK.sub(replaced, text[at:])])


def with_breaks(code: re.Match) -> str:
    """The text of code with the places where a line may break."""
    return re.sub(r"([_/.,(=|]|::)(?=\w)", r"\1<wbr>", code[0])


def page_of(path: str) -> str:
    """The Markdown text of the page for a file outside of docs/."""
    text = (ROOT / path).read_text("utf-8")
    if not path.endswith(".md"):
        return f"# `{path}`\n\n{fenced(text, path)}"
    programs = sorted((ROOT / path).parent.glob("*.py")) if path.startswith("firmware/") else []
    for program in programs:
        text += f"\n## `{program.name}`\n\n{fenced(program.read_text('utf-8'), program.name)}"
    return text


def fenced(text: str, name: str) -> str:
    language = "python" if name.endswith(".py") else "text"
    return f"````{language}\n{text.rstrip()}\n````\n"


def examples() -> list:
    """The entries of nav for the example programs."""
    folders = sorted(path.parent.name for path in (ROOT / "firmware").glob("*/README.md"))
    return ["firmware/README.md", *[{name: f"firmware/{name}/README.md"} for name in folders]]


def filled(nav: list) -> list:
    """A nav whose entries ``…/*`` are lists of pages."""
    made = {"commands/*": site_commands.nav, "firmware/*": examples}
    result = []
    for entry in nav:
        if isinstance(entry, dict):
            ((title, value),) = entry.items()
            if isinstance(value, list):
                value = filled(value)
            entry = {title: made[value]() if str(value) in made else value}
        result.append(entry)
    return result


# --- called by mkdocs ---------------------------------------------------------------------------


def on_config(config):
    config.nav = filled(config.nav)
    return config


def on_files(files, config):
    for uri, text in site_commands.pages().items():
        files.append(File.generated(config, uri, content=text))
    waiting = {*NAMED, "firmware/README.md"}
    for file in files.documentation_pages():
        if origin(file.src_uri).startswith(DOCS):
            waiting |= targets(file.content_string, origin(file.src_uri))
    known = set()
    while waiting:
        path = waiting.pop()
        if path.startswith(DOCS) or path in known or not (ROOT / path).exists():
            continue
        known.add(path)
        uri = address(path)
        if files.get_file_from_path(uri) is not None:
            continue
        file = File.generated(config, uri, content=page_of(origin(uri)))
        if path not in NAMED and not path.startswith("firmware/"):
            # A page that is reached by a link, and no entry of nav.
            file.inclusion = type(file.inclusion).NOT_IN_NAV
        files.append(file)
        if origin(uri).endswith(".md"):
            waiting |= targets(page_of(origin(uri)), origin(uri))
    return files


def on_page_markdown(markdown, page, config, files):
    if page.is_homepage:
        page.meta["hide"] = ["navigation"]  # its only entry would be itself
    return with_links_of_the_site(markdown, page.file.src_uri)


def on_page_content(html, page, config, files):
    """Let long names in tables break where they have a mark, as after an underscore."""
    return CELL.sub(lambda cell: CODE.sub(with_breaks, cell[0]), html)
