"""The parser of every command, whose errors are one line with the choice that was meant."""

from __future__ import annotations

import argparse
import re
from collections.abc import Sequence
from typing import Any, Final, NoReturn

# Characters of a list of options; beyond that an error names the help alone.
_LONGEST_LIST: Final = 80


class Parser(argparse.ArgumentParser):
    """An argument parser whose errors name the fault, what was meant, and the help."""

    def error(self, message: str) -> NoReturn:
        """Exit with status 2 and one line on standard error.

        Args:
            message: The fault.
        """
        wrong = re.search(r"invalid choice: (.+) \(choose from (.+)\)$", message)
        if wrong:
            from .errors import did_you_mean

            choices = [choice.strip("' ") for choice in wrong[2].split(",")]
            close = did_you_mean(wrong[1].strip("'"), choices)
            if close:
                message = message.partition(" (choose from ")[0] + close
        self.exit(2, f"{self.prog}: error: {message} (help: {self.prog} --help)\n")

    def parse_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse arguments; an unknown option is an error that names those that there are."""
        parsed, unknown = self.parse_known_args(args, namespace)
        if unknown and hasattr(parsed, "values"):
            from .values.typed_values import in_quotes

            hint = in_quotes(parsed, unknown)
            if hint:
                self.error(f"unrecognized arguments: {' '.join(unknown)}; {hint}")
        self.refuse(unknown)
        return parsed

    def has(self, option: str) -> bool:
        """Return whether there is an option of this name."""
        return any(option in action.option_strings for action in self._actions)

    def refuse(self, unknown: Sequence[str]) -> None:
        """Exit with an error unless the list of unknown arguments is empty."""
        if unknown:
            self.error(f"unrecognized arguments: {' '.join(unknown)}{self._known(unknown)}")

    def _known(self, unknown: Sequence[str]) -> str:
        """Return the option that comes close to an unknown one, else all of a few options."""
        from .errors import did_you_mean

        wrong = [word.partition("=")[0] for word in unknown if word.startswith("-")]
        if not wrong:
            return ""
        shown = [
            action.option_strings
            for action in self._actions
            if action.option_strings and action.help != argparse.SUPPRESS
        ]
        every = [option for options in shown for option in options]
        close = did_you_mean(wrong[0], every) if wrong[0].startswith("--") else ""
        listed = f" (options: {', '.join(options[-1] for options in shown)})"
        return close or (listed if len(listed) <= _LONGEST_LIST else "")
