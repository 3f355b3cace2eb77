"""A titled group of options, which states each option once: its flags, its help, its default."""

from __future__ import annotations

import argparse
from typing import Any


class OptionGroup:
    """Options under one title of the help of ``uros agent``.

    Args:
        title: The title; without one the options stand among the general ones.
        description: A sentence below the title.
        table: The table of a configuration file that has these options.
    """

    def __init__(
        self, title: str | None = None, description: str | None = None, table: str = "agent"
    ) -> None:
        self.table = table
        self.defaults: dict[str, Any] = {}
        self._title = title
        self._description = description
        self._options: list[tuple[tuple[str, ...], dict[str, Any]]] = []

    def add(self, *flags: str, default: Any = None, **keywords: Any) -> None:
        """Add an option.

        Args:
            flags: Its names; the first long one names the attribute.
            default: Its value on a command line without it. A repeatable option starts as an empty
                list, a switch that turns something off as True.
            keywords: The rest, as ``argparse`` takes them.
        """
        long = next(flag for flag in flags if flag.startswith("--"))
        name = keywords.get("dest") or long[2:].replace("-", "_")
        action = keywords.get("action")
        self.defaults[name] = {"append": [], "store_false": True}.get(action or "", default)
        self._options.append((flags, keywords))

    def declare(self, parser: argparse.ArgumentParser) -> None:
        """Add the options to a parser, which leaves out the attributes of those not given."""
        group: Any = parser
        if self._title is not None:
            group = parser.add_argument_group(self._title, self._description)
        for flags, keywords in self._options:
            group.add_argument(*flags, default=argparse.SUPPRESS, **keywords)

    def declare_hidden(
        self, parser: argparse.ArgumentParser, prefix: str, shown: tuple[str, ...] = ()
    ) -> None:
        """Add the options to a parser, with a prefix before their attributes.

        Args:
            parser: The parser.
            prefix: The prefix.
            shown: The attributes of the options that are in the help.
        """
        for (flags, keywords), name in zip(self._options, self.defaults, strict=True):
            hidden = {**keywords, "dest": prefix + name}
            if name not in shown:
                hidden["help"] = argparse.SUPPRESS
            parser.add_argument(*flags, default=argparse.SUPPRESS, **hidden)
