"""``uros agent check``: tells what is wrong with a configuration file."""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from typing import Any, Final

from ...errors import ToolError
from ..options.group import OptionGroup

NAME: Final = "check"
_HELP: Final = "check a configuration file"
_EPILOG: Final = """\
Each line names the file, the line in it, and what to change. A warning does not keep an agent from
starting, such as a port that is taken now. Exit status: 0 without errors, 1 with errors.
"""


def add_parser(transports: Any) -> None:
    """Declare ``check``, which is given instead of a transport."""
    parser = transports.add_parser(NAME, help=_HELP, description=_HELP, epilog=_EPILOG)
    parser.add_argument("path", metavar="FILE", help="the file that --config would name")


def run(args: argparse.Namespace, groups: Iterable[OptionGroup]) -> int:
    """Print what is wrong with the file; return 1 if an agent would not start with it.

    Raises:
        ToolError: The file cannot be read, or is no TOML.
    """
    from ....agent.policy.config_values import ConfigError
    from .faults import find_faults
    from .file import Config

    try:
        config = Config(args.path, groups)
    except ConfigError as error:
        raise ToolError(str(error)) from error
    find_faults(config)
    problems = sorted(config.problems, key=lambda problem: problem.line)
    for problem in problems:
        print(problem)
    errors = sum(not problem.is_warning for problem in problems)
    if errors:
        return 1
    warnings = len(problems)
    print(
        f"{config.path}: good, {_count(len(config.transports), 'transport')},"
        f" {_count(len(config.clients), 'rule')} for single boards"
        + (f", {_count(warnings, 'warning')}" if warnings else "")
    )
    return 0


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'s' * (number != 1)}"
