"""Options that ``uros bag record`` and ``uros bag play`` share, and what they select."""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterable, Sequence

from ... import names
from ..common import add_common, service_name, topic_name
from ..errors import UsageError
from .selection import Names, Selection


def regex(text: str) -> re.Pattern[str]:
    """Parse a regular expression."""
    try:
        return re.compile(text)
    except (re.error, OverflowError, RecursionError) as error:
        raise argparse.ArgumentTypeError(
            f"{text!r} is not a regular expression: {error}; put a backslash before a sign that is"
            " meant itself"
        ) from None


def add_selection(parser: argparse.ArgumentParser, verb: str) -> None:
    """Declare the options that select topics.

    Args:
        parser: The parser.
        verb: What is done with them, for the help.
    """
    kinds = (("topic", topic_name), ("service", service_name), ("action", service_name))
    for kind, convert in kinds:
        metavar = kind.upper()
        parser.add_argument(
            f"--{kind}s", metavar=metavar, type=convert, nargs="+", default=[],
            help=f"{kind}s to {verb}",
        )  # fmt: skip
        parser.add_argument(
            f"--exclude-{kind}s", metavar=metavar, type=convert, nargs="+", default=[],
            help=f"{kind}s not to {verb}",
        )  # fmt: skip
    parser.add_argument(
        "-e", "--regex", metavar="REGEX", type=regex,
        help=f"{verb} topics, services and actions whose name contains a match",
    )  # fmt: skip
    parser.add_argument(
        "-x", "--exclude-regex", "--exclude", metavar="REGEX", type=regex,
        help="exclude topics, services and actions whose name contains a match",
    )  # fmt: skip


def add_running(parser: argparse.ArgumentParser) -> None:
    """Declare the options of a command that runs until Ctrl-C."""
    parser.add_argument(
        "--qos-profile-overrides-path", metavar="FILE",
        help="YAML file with QoS profiles by topic, as for ros2 bag",
    )  # fmt: skip
    parser.add_argument("--disable-keyboard-controls", action="store_true", help="do not read keys")
    parser.add_argument("--log-level", help=argparse.SUPPRESS)
    add_common(parser)


def selected(
    args: argparse.Namespace,
    further_topics: Iterable[str] = (),
    every: Sequence[bool] = (False, False, False),
) -> Selection:
    """Return what the options of `add_selection` select.

    Args:
        args: The command line.
        further_topics: Topics that other options include.
        every: Whether all topics, services and actions are selected.
    """
    groups = [
        Names(is_every, frozenset([*included, *further]), frozenset(excluded))
        for is_every, included, further, excluded in zip(
            every,
            (args.topics, args.services, args.actions),
            (further_topics, (), ()),
            (args.exclude_topics, args.exclude_services, args.exclude_actions),
            strict=True,
        )
    ]
    topics, services, actions = groups
    return Selection(
        topics,
        services,
        actions,
        types=frozenset(map(_type_name, getattr(args, "topic_types", ()))),
        excluded_types=frozenset(map(_type_name, getattr(args, "exclude_topic_types", ()))),
        regex=args.regex,
        excluded_regex=args.exclude_regex,
        hidden=getattr(args, "include_hidden_topics", True),
    )


def _type_name(text: str) -> str:
    """Return a type in its normal spelling."""
    return names.type_from_dds(names.type_to_dds(text))


def key_values(pairs: Iterable[str]) -> dict[str, str]:
    """Return the pairs ``KEY=VALUE`` of an option; the last one of a key counts.

    Raises:
        UsageError: A text is no pair.
    """
    found = {}
    for pair in pairs:
        key, sign, value = pair.partition("=")
        if not sign or not key:
            raise UsageError(f"--custom-data {pair!r}: expected KEY=VALUE, such as robot=r2")
        found[key] = value
    return found
