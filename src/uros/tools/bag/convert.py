"""``uros bag convert``: write bags with other settings."""

from __future__ import annotations

import argparse
import re
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

from ..errors import ToolError, UsageError, did_you_mean
from .arguments import add_storage, existing_path
from .selection import Names, Selection

if TYPE_CHECKING:
    from ...bag.convert import Output

_ROOT: Final = "output_bags"
_MAX_FILE: Final = 1 << 20
_NS: Final = 10**9
_STORAGES: Final = ("mcap", "sqlite3")
# The presets of rosbag2's storages, with the compression that they stand for here.
_PRESETS: Final = {
    "": None, "none": None, "fastwrite": None, "resilient": None,
    "zstd_fast": "zstd", "zstd_small": "zstd",
}  # fmt: skip
# The keys of an output, with the type of each; those of the last line have no effect on files.
_KEYS: Final[Mapping[str, type]] = {
    **dict.fromkeys(
        ("uri", "storage_id", "storage_preset_profile", "storage_config_uri", "regex", "exclude",
         "exclude_regex", "compression_mode", "compression_format", "rmw_serialization_format"),
        str,
    ),
    **dict.fromkeys(
        ("all", "all_topics", "all_services", "all_actions", "include_hidden_topics"), bool
    ),
    **dict.fromkeys(("max_bagfile_size", "max_bagfile_duration", "start_time_ns", "end_time_ns"),
                    int),
    **dict.fromkeys(
        ("topics", "topic_types", "services", "actions", "exclude_topics", "exclude_topic_types",
         "exclude_services", "exclude_actions"),
        list,
    ),
    "custom_data": dict,
    **dict.fromkeys(
        ("max_cache_size", "snapshot_mode", "is_discovery_disabled", "topic_polling_interval",
         "node_prefix", "compression_queue_size", "compression_threads",
         "compression_threads_priority", "topic_qos_profile_overrides", "ignore_leaf_topics",
         "include_unpublished_topics", "disable_keyboard_controls", "use_sim_time"),
        object,
    ),
}  # fmt: skip
_EXPECTED: Final = {str: "text", bool: "true or false", int: "a number from 0 on", list: "a list",
                    dict: "keys with values"}  # fmt: skip


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros bag convert``."""
    parser.add_argument(
        "bags", metavar="BAG", nargs="*", help="the bag to read and the folder to write, without -o"
    )
    parser.add_argument(
        "-i", "--input", metavar=("URI", "STORAGE"), action="append", nargs="+", default=[],
        help="a bag to read, and its storage; may be repeated",
    )  # fmt: skip
    parser.add_argument(
        "-o", "--output-options", metavar="FILE", type=existing_path,
        help="YAML file with the bags to write below 'output_bags', as for ros2 bag convert",
    )  # fmt: skip
    add_storage(parser, "mcap")
    parser.add_argument(
        "--compression", choices=("zstd", "lz4"), help="without -o: compress the chunks"
    )


def run(args: argparse.Namespace) -> int:
    """Convert, and print what was written."""
    from ...bag.convert import Output, convert
    from ...bag.reader import BagReader

    inputs, outputs = _inputs(args), []
    if args.output_options:
        if args.bags or args.storage or args.compression:
            raise UsageError("-o has the bags to write; give inputs with -i, and no other option")
        outputs = read_outputs(args.output_options)
    elif len(args.bags) + len(inputs) < 2 or not args.bags:
        raise UsageError("give a bag and the folder to write, or -i BAG and -o FILE")
    else:
        storage = args.storage or _STORAGES[0]
        outputs = [Output(args.bags[-1], storage=storage, compression=args.compression)]
        inputs += [(bag, "") for bag in args.bags[:-1]]
    if not inputs:
        raise UsageError("give the bags to read with -i")
    readers = [BagReader(uri, storage) for uri, storage in inputs]
    for output, metadata in zip(outputs, convert(readers, outputs), strict=True):
        files = f"{len(metadata.files)} file{'s' if len(metadata.files) != 1 else ''}"
        print(f"{output.uri}: {metadata.message_count} messages in {files}")
    return 0


def read_outputs(path: str) -> list[Output]:
    """Return the outputs of a file as ``ros2 bag convert`` takes.

    Raises:
        ToolError: The file cannot be read, or has a wrong key or value.
    """
    from ...bag import yaml_text

    try:
        with open(path, "rb") as file:
            text = file.read(_MAX_FILE + 1)
    except OSError as error:
        raise ToolError(f"{path}: {error.strerror}") from error
    if len(text) > _MAX_FILE:
        raise ToolError(f"{path}: over {_MAX_FILE} bytes; these are no output options")
    root = yaml_text.load(text, path)
    nodes = root.get(_ROOT) if isinstance(root, Mapping) else None
    if not isinstance(nodes, list) or not nodes:
        raise ToolError(f"{path}: expected the key {_ROOT} with a list of bags")
    return [_output(node, f"{path}: {_ROOT}[{at}]") for at, node in enumerate(nodes)]


def _inputs(args: argparse.Namespace) -> list[tuple[str, str]]:
    inputs = []
    for words in args.input:
        if len(words) > 2 or (len(words) == 2 and words[1] not in _STORAGES):
            raise UsageError(
                f"-i {' '.join(words)}: expected a bag and its storage, {' or '.join(_STORAGES)}"
            )
        inputs.append((words[0], words[1] if len(words) == 2 else ""))
    return inputs


def _output(node: object, where: str) -> Output:
    from ...bag.convert import Output

    if not isinstance(node, Mapping):
        raise ToolError(f"{where}: expected keys with values, such as uri: FOLDER")
    values = {str(key): _checked(str(key), value, where) for key, value in node.items()}
    get = values.get
    if not get("uri"):
        raise ToolError(f"{where}: uri is missing, the folder to write")
    if get("storage_config_uri"):
        raise ToolError(f"{where}: storage_config_uri is not taken; give compression_format")
    storage = get("storage_id") or _STORAGES[0]
    stop = get("end_time_ns")
    return Output(
        values["uri"],
        _selection(values, where).takes,
        storage,
        _compression(values, where),
        get("max_bagfile_size", 0),
        get("max_bagfile_duration", 0) * _NS,
        get("start_time_ns") or None,
        stop + 1 if stop else None,
        {str(key): str(value) for key, value in (get("custom_data") or {}).items()},
    )


def _checked(key: str, value: object, where: str) -> Any:
    """Return a value if it is of its key's type; an empty one for null."""
    if key not in _KEYS:
        raise ToolError(f"{where}: there is no key {key!r}{did_you_mean(key, _KEYS)}")
    kind = _KEYS[key]
    if kind is object:
        return value
    if value is None:
        return kind()
    wrong = not isinstance(value, kind) or (kind is int and isinstance(value, bool))
    if kind is list and not wrong:
        wrong = not all(isinstance(each, str) for each in value)  # type: ignore[attr-defined]
    if wrong or (kind is int and value < 0):  # type: ignore[operator]
        raise ToolError(f"{where}: {key}: expected {_EXPECTED[kind]}, not {value!r:.60}")
    return value


def _compression(values: Mapping[str, Any], where: str) -> Any:
    """Return the compression of chunks that an output asks for."""
    preset = values.get("storage_preset_profile", "")
    if preset not in _PRESETS:
        raise ToolError(f"{where}: storage_preset_profile: expected {', '.join(_PRESETS)[2:]}")
    mode = values.get("compression_mode", "").lower()
    if mode not in ("", "none", "file", "message"):
        raise ToolError(f"{where}: compression_mode: expected none, file or message")
    if mode in ("", "none"):
        return _PRESETS[preset]
    return values.get("compression_format") or "zstd"


def _selection(values: Mapping[str, Any], where: str) -> Selection:
    every = values.get("all", False)
    groups = [
        Names(
            every or values.get(f"all_{kind}", False),
            frozenset(values.get(kind, ())),
            frozenset(values.get(f"exclude_{kind}", ())),
        )
        for kind in ("topics", "services", "actions")
    ]
    topics, services, actions = groups
    return Selection(
        topics,
        services,
        actions,
        types=frozenset(values.get("topic_types", ())),
        excluded_types=frozenset(values.get("exclude_topic_types", ())),
        regex=_regex(values, "regex", where),
        excluded_regex=_regex(values, "exclude_regex", where) or _regex(values, "exclude", where),
        hidden=values.get("include_hidden_topics", False),
    )


def _regex(values: Mapping[str, Any], key: str, where: str) -> re.Pattern[str] | None:
    text = values.get(key)
    try:
        return re.compile(text) if text else None
    except (re.error, OverflowError, RecursionError) as error:
        raise ToolError(f"{where}: {key}: {text!r} is no regular expression ({error})") from error
