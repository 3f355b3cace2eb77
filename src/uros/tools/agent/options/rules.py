"""The options of ``uros agent`` about what boards get on the network."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any, Final

from ...common import domain, positive_float, positive_int
from ...errors import ToolError
from .group import OptionGroup

if TYPE_CHECKING:
    from ....agent.policy.rules import Rules

OPTIONS: Final = OptionGroup(
    "rules for all boards", "A rules file (--control) can hold rules for single boards."
)
OPTIONS.add(
    "--domain", type=domain, metavar="N",
    help="ROS domain of all boards (default: the one that each board asks for)",
)  # fmt: skip
OPTIONS.add("--namespace", metavar="NS", help="put nodes, topics and services below NS")
OPTIONS.add(
    "--remap", metavar="OLD:=NEW", action="append",
    help="rename a topic or service; may be repeated",
)  # fmt: skip
OPTIONS.add(
    "--qos", metavar="TOPIC:POLICY=VALUE,...", action="append",
    help="change the QoS of a topic, such as /odom:reliability=best_effort,depth=1;"
    " may be repeated",
)  # fmt: skip
OPTIONS.add(
    "--max-rate", type=positive_float, metavar="HZ",
    help="maximum number of messages that a node may send in a second",
)  # fmt: skip
OPTIONS.add(
    "--max-size", type=positive_int, metavar="BYTES",
    help="maximum length of a message that a node may send",
)  # fmt: skip
OPTIONS.add(
    "--control", metavar="FILE", action="append",
    help="TOML file with rules for single boards (docs/agent.md); may be repeated",
)  # fmt: skip


def make_rules(options: argparse.Namespace) -> Rules:
    """Make the rules: those of the files in their order, then those of the command line.

    Raises:
        ConfigError: A rule is wrong.
        ToolError: An option is malformed.
    """
    from ....agent.policy.config_values import ConfigError
    from ....agent.policy.rules import Rules

    rules = Rules()
    for file in options.control:
        rules.load(file)
    rule: dict[str, Any] = {
        name: value
        for name in ("namespace", "max_rate", "max_size")
        if (value := getattr(options, name)) is not None
    }
    if options.remap:
        rule["remap"] = _remap(options.remap)
    for text in options.qos:
        topic, fields = _qos(text)
        rule.setdefault("qos", {}).setdefault(topic, {}).update(fields)
    try:
        if rule:
            rules.add(rule)
    except ConfigError as error:
        raise ConfigError(f"the command line: {error}") from error
    return rules


def _remap(texts: list[str]) -> dict[str, str]:
    renamed: dict[str, str] = {}
    for text in texts:
        old, new = _pair(text, ":=", "--remap", "OLD:=NEW")
        if renamed.setdefault(old, new) != new:
            raise ToolError(f"--remap {text!r}: {old} is renamed to {renamed[old]} already")
    return renamed


def _pair(text: str, sign: str, option: str, form: str) -> tuple[str, str]:
    left, found, right = text.partition(sign)
    if not (left and found and right):
        raise ToolError(f"{option} {text!r} is not {form}")
    return left, right


def _qos(text: str) -> tuple[str, dict[str, Any]]:
    from ....agent.policy.config_values import typed

    form = "TOPIC:POLICY=VALUE,..."
    topic, policies = _pair(text, ":", "--qos", form)
    fields = dict(_pair(policy, "=", "--qos", form) for policy in policies.split(","))
    return topic, {name: typed(value) for name, value in fields.items()}
