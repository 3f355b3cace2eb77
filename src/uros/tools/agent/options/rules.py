"""The options of ``uros agent`` about what boards get on the network, which rules can say too."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any, Final

from ...common import domain, positive_float, positive_int
from ...errors import ToolError

if TYPE_CHECKING:
    from ....agent.policy.rules import Control

DEFAULTS: Final[dict[str, Any]] = {
    "domain": None,
    "control": [],
    "namespace": None,
    "remap": [],
    "qos": [],
    "max_rate": None,
    "max_size": None,
}


def add_options(common: argparse.ArgumentParser) -> None:
    """Declare them."""
    group = common.add_argument_group(
        "what boards get", "For all boards; a file of rules (--control) can say which."
    )
    group.add_argument(
        "--domain", type=domain, metavar="N",
        help="put them into this ROS domain (default: the one each board asks for)",
    )  # fmt: skip
    group.add_argument(
        "--namespace", metavar="NS", help="put their nodes, topics and services below NS"
    )
    group.add_argument(
        "--remap", metavar="OLD:=NEW", action="append",
        help="rename a topic or service; may be repeated",
    )  # fmt: skip
    group.add_argument(
        "--qos", metavar="TOPIC:POLICY=VALUE,...", action="append",
        help="change the QoS of a topic, such as /odom:reliability=best_effort,depth=1;"
        " may be repeated",
    )  # fmt: skip
    group.add_argument(
        "--max-rate", type=positive_float, metavar="HZ",
        help="messages a second that a node may send",
    )  # fmt: skip
    group.add_argument(
        "--max-size", type=positive_int, metavar="BYTES", help="longest message that may be sent"
    )
    group.add_argument(
        "--control", metavar="FILE", action="append",
        help="TOML file of rules for single boards; may be repeated (docs/agent.md)",
    )  # fmt: skip


def make_control(options: argparse.Namespace) -> Control:
    """The rules: of the files in their order, then of the command line. Raises ControlError."""
    from ....agent.policy.config_values import ControlError
    from ....agent.policy.rules import Control

    control = Control()
    for file in options.control:
        control.load(file)
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
            control.add(rule)
    except ControlError as error:
        raise ControlError(f"the command line: {error}") from error
    return control


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
    fields = dict(_pair(it, "=", "--qos", form) for it in policies.split(","))
    return topic, {name: typed(it) for name, it in fields.items()}
