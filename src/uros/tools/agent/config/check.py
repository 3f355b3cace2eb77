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
Each line names the file, the line in it, and what to change. With an error no agent starts. A
warning is about what may pass, or keeps boards away: a port that another program has, a device that
is not there, a certificate that has ended or ends soon. What an agent that runs with the file has
open is no fault. Exit status: 0 without errors, 1 with errors; with --strict also 1 with warnings.
"""


def add_parser(transports: Any) -> None:
    """Declare ``check``, which is given instead of a transport."""
    parser = transports.add_parser(NAME, help=_HELP, description=_HELP, epilog=_EPILOG)
    parser.add_argument("path", metavar="FILE", help="the file that --config would name")
    parser.add_argument(
        "--strict", action="store_true", help="exit status 1 with warnings too, for a nightly job"
    )


def run(args: argparse.Namespace, groups: Iterable[OptionGroup]) -> int:
    """Print what is wrong with the file.

    Returns:
        1 if an agent would not start with it, or with ``--strict`` if there are warnings; else 0.

    Raises:
        ToolError: The file cannot be read.
    """
    from ....agent.policy.config_values import ConfigError
    from ....agent.policy.toml_file import TomlError
    from .faults import find_faults
    from .file import Config, Problem

    try:
        config = Config(args.path, groups)
    except TomlError as error:
        print(Problem(args.path, error.line, error.reason))
        return 1
    except ConfigError as error:
        raise ToolError(str(error)) from error
    find_faults(config)
    problems = sorted(config.problems, key=lambda problem: problem.line)
    for problem in problems:
        print(problem)
    if any(args.strict or not problem.is_warning for problem in problems):
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
