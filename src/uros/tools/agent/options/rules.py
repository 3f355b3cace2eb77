"""The options of ``uros agent`` about what boards get on the network."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

from ...common import domain, positive_float, positive_int
from ...errors import ToolError
from .group import OptionGroup

if TYPE_CHECKING:
    from ....agent.policy.rules import Rules
    from ..config.file import Config

# The options that make the rule for all boards.
RULE: Final = ("namespace", "max_rate", "max_size", "remap", "qos")

OPTIONS: Final = OptionGroup(
    "rules for all boards", "A rules file (--control) can hold rules for single boards.",
    table="rules",
)  # fmt: skip
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


def make_rules(options: argparse.Namespace, config: Config | None = None) -> Rules:
    """Make the rules. Where several apply, the later one wins.

    Their order: the table ``[rules]`` of the configuration, the files of ``--control``, the tables
    ``[[client]]`` of the configuration, the command line.

    Args:
        options: The options of the command line; ``control`` is that of the configuration if the
            command line has none.
        config: The configuration file.

    Raises:
        ConfigError: A rule is wrong.
        ToolError: An option is malformed.
    """
    from ....agent.policy.rules import Rules

    rules = Rules()
    if config is not None and (rule := rule_of(config.options)):
        _add(rules, rule, f"{config.path}: [rules]")
    for file in options.control:
        rules.load(file)
    if config is not None:
        for table in config.clients:
            rules.add(table)
    if rule := rule_of(vars(options)):
        _add(rules, rule, "the command line")
    return rules


def _add(rules: Rules, rule: dict[str, Any], where: str) -> None:
    from ....agent.policy.config_values import faults_of

    with faults_of(where):
        rules.add(rule)


def rule_of(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the rule for all boards that options make, empty if they make none.

    Raises:
        ToolError: An option is malformed.
    """
    rule: dict[str, Any] = {
        name: value
        for name in ("namespace", "max_rate", "max_size")
        if (value := options.get(name)) is not None
    }
    if renamed := options.get("remap"):
        rule["remap"] = _remap(renamed)
    for text in options.get("qos") or []:
        topic, fields = _qos(text)
        rule.setdefault("qos", {}).setdefault(topic, {}).update(fields)
    return rule


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
