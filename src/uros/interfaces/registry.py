"""Search path of interface definitions, by type name. Host only.

The first match is used: folders given to `add_folder` in their order, those in UROS_INTERFACES (in
the form of PATH), the packaged definitions of the chosen distribution (see `distro`), then
``share`` of every prefix in AMENT_PREFIX_PATH. A file is parsed when its type is requested, so a
broken file affects only its own type.
"""

from __future__ import annotations

import hashlib
import os
import re
from collections import ChainMap
from collections.abc import Iterable, Mapping
from functools import cache, lru_cache
from pathlib import Path
from typing import Final, Union

from . import distro
from .errors import InterfaceError
from .parse import Action, Message, Service, parse_action, parse_msg, parse_srv

Definition = Union[Message, Service, Action]

KINDS: Final = ("msg", "srv", "action")
VARIABLE: Final = "UROS_INTERFACES"
"""The environment variable with folders of definitions, which `os.pathsep` separates."""
MAX_FILE: Final = 1 << 20
"""Largest definition file, in bytes; a larger one is rejected."""
# The most types of the same name in other packages that are suggested for an unknown one.
_SUGGESTED: Final = 3
# How much less close than the closest one a type may be that is suggested beside it, of 1.
_BESIDE: Final = 0.1
_SKIP: Final = {"node_modules", "__pycache__"}
_SECTION: Final = {
    "srv": re.compile(r"([^_]+)_(Request|Response|Event)"),
    "action": re.compile(
        r"([^_]+)_(Goal|Result|Feedback|FeedbackMessage"
        r"|(SendGoal|GetResult)(_Request|_Response|_Event)?)"
    ),
}
_PACKAGED: Final = Path(__file__).parent / "definitions"

_added: dict[str, Path] = {}


def normalize(name: str) -> str:
    """Return ``pkg/msg/Name`` for ``pkg/Name``, ``pkg/msg/Name`` or ``pkg::msg::dds_::Name_``.

    ``pkg/Name`` means the message, or the service (action) where there is no such message.
    """
    parts = name.replace("::", "/").split("/")
    if len(parts) == 4 and parts[2] == "dds_" and parts[3].endswith("_"):
        parts = [parts[0], parts[1], parts[3][:-1]]
    if len(parts) == 2 and all(parts):
        candidates = [f"{parts[0]}/{kind}/{parts[1]}" for kind in KINDS]
        return next((full for full in candidates if _find(full) is not None), candidates[0])
    if len(parts) != 3 or not all(parts) or parts[1] not in KINDS:
        meant = _meant(name) or "; write it as std_msgs/msg/Int32"
        raise InterfaceError(f"bad type name {name!r}{meant}")
    return "/".join(parts)


def add_folder(path: str | os.PathLike[str]) -> list[str]:
    """Make the .msg, .srv and .action files under ``path`` known; returns their type names.

    ``path`` is a package folder (``my_pkg/msg/*.msg``), a tree of many packages (a workspace or a
    share folder), or a flat folder of files whose package is the folder's name. The name in a
    package.xml beside the msg folder overrides the folder's name. Call it before the types are
    loaded: a loaded class is not replaced.
    """
    names = _definitions_in(path)
    for name, file in names.items():
        _added.setdefault(name, file)
    _definition.cache_clear()
    return sorted(names)


def _definitions_in(path: str | os.PathLike[str]) -> dict[str, Path]:
    root = Path(path).resolve()
    if not root.is_dir():
        raise InterfaceError(f"{path}: no such folder; give a folder that holds .msg files")
    names = _scan(root)
    if not names:
        raise InterfaceError(
            f"{path}: no .msg, .srv or .action file in it; give a package, a workspace, or a folder"
            " of .msg files"
        )
    return names


def _own() -> Mapping[str, Path]:
    """Return the user's own definitions: of `add_folder`, then of UROS_INTERFACES."""
    return ChainMap(_added, _of_variable(os.environ.get(VARIABLE, "")))


def check_variable() -> None:
    """Check the folders of UROS_INTERFACES, which otherwise count when a type is looked up.

    Raises:
        InterfaceError: One does not exist, or has no definitions.
    """
    _own()


@lru_cache(maxsize=1)
def _of_variable(folders: str) -> dict[str, Path]:
    names: dict[str, Path] = {}
    for folder in reversed([path for path in folders.split(os.pathsep) if path]):
        try:
            names.update(_definitions_in(folder))
        except InterfaceError as error:
            raise InterfaceError(f"{VARIABLE}: {error}") from error
    return names


def fingerprint() -> list[str] | None:
    """Return what decides which definition a type has, besides the packaged definitions.

    That is the distribution, and each of the user's own definitions with a digest of its text.
    None if they cannot be told: with AMENT_PREFIX_PATH, whose folders are too many to read, and if
    a file cannot be read.

    Raises:
        InterfaceError: A folder of UROS_INTERFACES is wrong.
    """
    if _ament_shares():
        return None
    try:
        own = [(name, hashlib.sha256(file.read_bytes())) for name, file in _own().items()]
    except OSError:
        return None
    return [distro.chosen(), *sorted(f"{name} {text.hexdigest()}" for name, text in own)]


def is_added(name: str) -> bool:
    """Whether the type (in its normal spelling) is the user's own, so in no table of hashes."""
    return file_type(name) in _own()


def exists(name: str) -> bool:
    """Whether some file defines the type (in its normal spelling)."""
    return _find(file_type(name)) is not None


def list_types() -> list[str]:
    """Return the names of all known messages, services and actions, sorted; parses nothing."""
    names = {*_own(), *_packaged()}
    for share in _ament_shares():
        names.update(
            f"{file.parent.parent.name}/{file.parent.name}/{file.stem}"
            for kind in KINDS
            for file in share.glob(f"*/{kind}/*.{kind}")
        )
    return sorted(names)


def packages(kinds: Iterable[str] = KINDS) -> list[str]:
    """Return the names of the packages that have types of any of the kinds, sorted."""
    wanted = tuple(kinds)
    parts = (name.split("/") for name in list_types())
    return sorted({package for package, kind, _ in parts if kind in wanted})


def packaged_types() -> list[str]:
    """Return the names of the types that come with this package, sorted."""
    return sorted(_packaged())


def has_package(package: str) -> bool:
    """Whether any type of the package is known."""
    if any(name.startswith(package + "/") for name in (*_own(), *_packaged())):
        return True
    return any((share / package / kind).is_dir() for share in _ament_shares() for kind in KINDS)


def names_in(package: str, kind: str) -> list[str]:
    """Return the plain names of a package's types of one kind, sorted."""
    prefix = f"{package}/{kind}/"
    names = {n[len(prefix) :] for n in (*_own(), *_packaged()) if n.startswith(prefix)}
    for share in _ament_shares():
        names.update(file.stem for file in (share / package / kind).glob(f"*.{kind}"))
    return sorted(names)


def definition(name: str) -> Definition:
    """Return the parsed definition of a type in its normal spelling.

    ``pkg/srv/Name_Request`` (and Response) gives that section, ``pkg/srv/Name_Event`` the message
    of service introspection; ``pkg/action/Name_Goal`` (and Result, Feedback, SendGoal,
    SendGoal_Request, FeedbackMessage …) a structure of the action.
    """
    return _definition(name, distro.chosen())


@cache
def _definition(name: str, _: str) -> Definition:
    owner = file_type(name)
    if owner != name:
        whole = definition(owner)
        parts: list[Definition]
        if isinstance(whole, Action):
            services = [whole.send_goal, whole.get_result]
            parts = [*whole.parts, *services, *[service.event for service in services]]
        elif isinstance(whole, Service):
            parts = [*whole.parts, whole.event]
        else:
            parts = list(whole.parts)
        return next(part for part in parts if part.type_name == name)
    return parse(name, *source(name))


def source(name: str) -> tuple[str, str]:
    """Return the text and the path of the file that defines a type (in its normal spelling)."""
    path = _find(name)
    if path is None:
        raise InterfaceError(_unknown(name))
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InterfaceError(f"{path}: {error.strerror}; make the file readable") from error
    if len(data) > MAX_FILE:
        raise InterfaceError(f"{path}: over {MAX_FILE} bytes; this is no definition")
    try:
        return data.decode(), str(path)
    except UnicodeDecodeError as error:
        raise InterfaceError(f"{path}: not UTF-8 text ({error}); save it as UTF-8") from error


def sourced_texts(name: str) -> list[str]:
    """Return the texts of a sourced ROS 2 that define a type, and can be read."""
    package, kind, plain = name.split("/")
    texts = []
    for share in _ament_shares():
        try:
            data = (share / package / kind / f"{plain}.{kind}").read_bytes()
            texts.append(data[: MAX_FILE + 1].decode())
        except (OSError, UnicodeDecodeError):
            continue
    return texts


def parse(name: str, text: str, path: str) -> Definition:
    """Return the definition of a type in a text.

    Args:
        name: The type, in its normal spelling.
        text: The text of its file.
        path: The file, for messages.

    Raises:
        InterfaceError: The text is wrong.
    """
    package, kind, plain = name.split("/")
    if kind == "msg":
        return parse_msg(text, package, plain, path)
    if kind == "srv":
        return parse_srv(text, package, plain, path)
    return parse_action(text, package, plain, path)


def message(name: str) -> Message:
    """Return the definition of a structure: a message, or a section of a service or action."""
    structure = definition(name)
    if not isinstance(structure, Message):
        raise InterfaceError(f"{name} is not a message; its sections are")
    return structure


def closure(root: Message) -> dict[str, Message]:
    """Return all messages that ``root`` nests, at any depth, by name, without ``root`` itself."""
    nested: dict[str, Message] = {}

    def visit(parent: Message, path: tuple[str, ...]) -> None:
        for name in parent.nested:
            if name in path:
                raise InterfaceError(
                    f"{parent.source}: {name} contains itself; a message cannot be recursive"
                )
            if name not in nested:
                try:
                    child = message(name)
                except InterfaceError as error:
                    raise InterfaceError(f"{parent.source}: {error}") from error
                visit(child, (*path, name))
                nested[name] = child

    visit(root, (root.type_name,))
    return nested


def file_type(name: str) -> str:
    """Return the type whose file defines a type (in its normal spelling); usually the same."""
    head, _, plain = name.rpartition("/")
    section = _SECTION.get(head.rpartition("/")[2])
    match = section.fullmatch(plain) if section else None
    return f"{head}/{match[1]}" if match else name


def _packaged() -> dict[str, Path]:
    return _packaged_of(distro.chosen())


@lru_cache(maxsize=len(distro.DISTROS))
def _packaged_of(name: str) -> dict[str, Path]:
    newest = _scan(_PACKAGED).items()
    files = {type_: file for type_, file in newest if not distro.missing(type_, name)}
    for folder in reversed(distro.older(name)):
        files.update(_scan(folder))
    return files


def _find(name: str) -> Path | None:
    if file := _own().get(name) or _packaged().get(name):
        return file
    parts = name.split("/")
    if len(parts) != 3 or any(part in ("", ".", "..") or os.sep in part for part in parts):
        return None
    for share in _ament_shares():
        path = share / parts[0] / parts[1] / f"{parts[2]}.{parts[1]}"
        if path.is_file():
            return path
    return None


def _ament_shares() -> list[Path]:
    prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    return [share for prefix in prefixes if prefix and (share := Path(prefix) / "share").is_dir()]


def _scan(root: Path) -> dict[str, Path]:
    definitions: dict[str, Path] = {}
    for path, subfolders, files in os.walk(root):
        subfolders[:] = sorted(f for f in subfolders if not f.startswith(".") and f not in _SKIP)
        folder = Path(path)
        in_kind = folder.name in KINDS
        package = ""
        for file in sorted(files):
            stem, _, suffix = file.rpartition(".")
            if suffix not in KINDS or not stem:
                continue
            if in_kind and suffix != folder.name:
                continue
            package = package or _package(folder.parent if in_kind else folder)
            definitions.setdefault(f"{package}/{suffix}/{stem}", folder / file)
    return definitions


def _package(folder: Path) -> str:
    try:
        text = (folder / "package.xml").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return folder.name
    match = re.search(r"<name>\s*([a-z0-9_]+)\s*</name>", text)
    return match[1] if match else folder.name


def _unknown(name: str) -> str:
    first = distro.since(name)
    if first:
        return (
            f"unknown type {name!r}: it came with ROS 2 {first.capitalize()}, and these are the"
            f" definitions of {distro.chosen().capitalize()}; choose another by ROS_DISTRO or"
            " --distro, or give the folder of its definition by --interfaces DIR"
        )
    return (
        f"unknown type {name!r}{_meant(name)}; give the folder of its definition by --interfaces"
        " DIR, or by the variable UROS_INTERFACES"
    )


def _meant(name: str) -> str:
    """Return the known types that come close to a name, the closest first, or nothing."""
    from difflib import SequenceMatcher

    from ..similar import closest

    names = list_types()
    wanted = name.replace("::", "/").replace(".", "/").lower()
    plain = wanted.rpartition("/")[2]
    same = [known for known in names if known.lower().rpartition("/")[2] == plain]
    ratios = {known: SequenceMatcher(None, wanted, known.lower()).ratio() for known in same}
    close = sorted(same, key=lambda known: -ratios[known])[:_SUGGESTED]
    if "/" in wanted and close:  # the package counts too
        close = [known for known in close if ratios[known] > ratios[close[0]] - _BESIDE]
    if not close:
        if "/" in wanted:
            close = closest(wanted, names)
        else:
            plains = {known.rpartition("/")[2]: known for known in names}
            close = [plains[match] for match in closest(plain, plains)]
    return f" (did you mean {' or '.join(close)}?)" if close else ""
