"""Reads a configuration file of ``uros agent``; collects all its mistakes, with their lines.

::

    [agent]
    state = "/var/lib/uros/state"

    [[transport]]
    type = "udp4"
    port = 8888

    [[client]]                  # a rule, as in a rules file
    key = "0x4B0CBE99"
    namespace = "/left"
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterable
from typing import Any, Final, NamedTuple

from ....agent.policy.config_values import ConfigError, shown
from ....agent.policy.rules import parse_rule
from ....agent.policy.toml_file import TomlFile
from ...errors import did_you_mean
from ..options.group import OptionGroup
from ..options.transports import TRANSPORTS
from .schema import Key, TransportKeys, tables

TRANSPORT: Final = "transport"
CLIENT: Final = "client"
_TYPE: Final = "type"


class Problem(NamedTuple):
    """What is wrong with a configuration file.

    Attributes:
        path: The file.
        line: The line, from 1.
        text: What is wrong, and the remedy.
        is_warning: Whether an agent starts with it nevertheless.
    """

    path: str
    line: int
    text: str
    is_warning: bool = False

    def __str__(self) -> str:
        return f"{self.path}:{self.line}: {'warning: ' * self.is_warning}{self.text}"


class Config:
    """The content of a configuration file.

    Attributes:
        path: The file.
        options: The options of the agent that it gives, by attribute.
        transports: The options of its transports, as the command line's parser gives them.
        clients: The rules for single clients, as they are in the file.
        problems: Its mistakes; what is in error is left out of the rest.

    Args:
        path: The file.
        groups: The options of the agent.

    Raises:
        ConfigError: The file cannot be read, or is no TOML.
    """

    def __init__(self, path: str, groups: Iterable[OptionGroup]) -> None:
        self.path = path
        self._file = TomlFile(path)
        self._folder = os.path.dirname(path)
        self.options: dict[str, Any] = {}
        self.transports: list[argparse.Namespace] = []
        self.clients: list[dict[str, Any]] = []
        self.problems: list[Problem] = []
        self._tables = tables(groups)
        self._places: dict[int, int] = {}  # indexes of [[transport]] tables, by id of the options
        for name, value in self._file.content.items():
            if name == TRANSPORT:
                self._read_transports(value)
            elif name == CLIENT:
                self._read_clients(value)
            elif name in self._tables:
                self._read_table(name, value)
            else:
                self._refuse_table(name, value)

    def problem(self, text: str, *place: str | int, is_warning: bool = False) -> None:
        """Record a mistake.

        Args:
            text: What is wrong, and the remedy.
            place: The way to the value: names of tables and keys, and indexes.
            is_warning: Whether an agent starts with it nevertheless.
        """
        line = self._file.line(*place)
        self.problems.append(Problem(self.path, line, text, is_warning))

    def error(self, error: ConfigError, about: str, *place: str | int) -> None:
        """Record all faults of an error.

        Args:
            error: The error.
            about: The table that has them, for people.
            place: The way to this table or value.
        """
        for fault in error.faults:
            self.problem(f"{about}: {fault}", *place, *fault.place)

    def place_of(self, part: argparse.Namespace) -> tuple[str, int]:
        """Return the way to the table of a transport."""
        return TRANSPORT, self._places[id(part)]

    def place_of_option(self, attribute: str) -> tuple[str, ...]:
        """Return the way to an option of the agent: its table and its key."""
        return next(
            (table, name)
            for table, keys in self._tables.items()
            for name, key in keys.items()
            if key.attribute == attribute
        )

    def place_of_client(self, rule: dict[str, Any]) -> tuple[str, int]:
        """Return the way to the table of a rule."""
        return CLIENT, next(
            index for index, each in enumerate(self._file.content[CLIENT]) if each is rule
        )

    # --- tables ---------------------------------------------------------------------------

    def _refuse_table(self, name: str, value: Any) -> None:
        known = (*self._tables, TRANSPORT, CLIENT)
        table = None
        if not isinstance(value, dict):
            table = next((table for table, keys in self._tables.items() if name in keys), None)
        if table is not None:
            text = f"{name} belongs into the table [{table}]"
        elif isinstance(value, dict) and name in TRANSPORTS:
            text = f'there is no table [{name}]: write [[transport]] and type = "{name}"'
        else:
            close = did_you_mean(name, known) or f"; there are {_headers(self._tables)}"
            text = f"there is no {'table ' * isinstance(value, (dict, list))}{name!r}{close}"
        self.problem(text, name)

    def _read_table(self, table: str, values: Any) -> None:
        if not isinstance(values, dict):
            self.problem(f"{table} is a table: write [{table}]", table)
            return
        for name, value in values.items():
            key = self._tables[table].get(name)
            if key is None:
                self._refuse_key(table, name, f"[{table}]", self._tables[table])
                continue
            parsed = self._parse(key, value, table, name)
            if parsed is not None:
                self.options[key.attribute] = parsed

    def _parse(self, key: Key, value: Any, *place: str | int) -> Any:
        """Return the value of a key; None if it is in error, or turns the option off."""
        try:
            return key.parse(value, self._folder)
        except ConfigError as error:
            for fault in error.faults:
                self.problem(str(fault), *place)
            return None

    def _refuse_key(self, table: str, name: str, about: str, keys: Iterable[str]) -> None:
        elsewhere = [
            other for other, known in self._tables.items() if other != table and name in known
        ]
        option = name.replace("-", "_")
        if elsewhere:
            text = f"{about} has no {name!r}: it belongs into [{elsewhere[0]}]"
        elif option != name and option in keys:
            text = f"{about} has no {name!r}: write {option} (with _)"
        else:
            close = did_you_mean(name, keys) or f"; there are {', '.join(keys)}"
            text = f"{about} has no {name!r}{close}"
        self.problem(text, table, name)

    # --- arrays of tables -------------------------------------------------------------------

    def _read_transports(self, values: Any) -> None:
        if not _is_array_of_tables(values):
            self.problem("transports are [[transport]] tables, with two brackets", TRANSPORT)
            return
        for index, table in enumerate(values):
            kind = table.get(_TYPE)
            if kind is None:
                self.problem(
                    f'the transport has no type: write type = "udp4", or another of'
                    f" {', '.join(TRANSPORTS)}", TRANSPORT, index,
                )  # fmt: skip
            elif not isinstance(kind, str) or kind not in TRANSPORTS:
                close = did_you_mean(str(kind), TRANSPORTS)
                text = f"there is no type {shown(kind)}{close or '; there are '}"
                self.problem(
                    text + ("" if close else ", ".join(TRANSPORTS)), TRANSPORT, index, _TYPE
                )
            else:
                self._read_transport(index, kind, table)

    def _read_transport(self, index: int, kind: str, table: dict[str, Any]) -> None:
        known = TransportKeys(kind)
        part = argparse.Namespace(transport=kind, more=[])
        for key in known.keys.values():
            setattr(part, key.attribute, key.default)
        before = len(self.problems)
        for name, value in table.items():
            if name == _TYPE:
                continue
            if name not in known.keys:
                self._refuse_transport_key(index, name, kind, known)
                continue
            parsed = self._parse(known.keys[name], value, TRANSPORT, index, name)
            setattr(part, known.keys[name].attribute, parsed)
        for names, required in known.exclusive:
            given = [name for name in names if name in table]
            if len(given) > 1:
                self.problem(f"{' and '.join(given)} exclude each other: keep one of them",
                             TRANSPORT, index, given[-1])  # fmt: skip
            elif required and not given:
                self.problem(f"the {kind} transport needs {' or '.join(names)}", TRANSPORT, index)
        for key in known.keys.values():
            if key.required and key.name not in table:
                self.problem(f"the {kind} transport needs {key.name}", TRANSPORT, index)
        if len(self.problems) == before:
            self._places[id(part)] = index
            self.transports.append(part)

    def _refuse_transport_key(self, index: int, name: str, kind: str, known: TransportKeys) -> None:
        elsewhere = [table for table, keys in self._tables.items() if name in keys]
        option = name.replace("-", "_")
        text = f"the {kind} transport has no {name!r}"
        if elsewhere:
            text += f": it belongs into [{elsewhere[0]}]"
        elif option != name and option in known.keys:
            text += f": write {option} (with _)"
        else:
            names = (_TYPE, *known.keys)
            text += did_you_mean(name, names) or f"; there are {', '.join(names)}"
        self.problem(text, TRANSPORT, index, name)

    def _read_clients(self, values: Any) -> None:
        if not _is_array_of_tables(values):
            self.problem("rules are [[client]] tables, with two brackets", CLIENT)
            return
        for index, table in enumerate(values):
            try:
                parse_rule(table)
            except ConfigError as error:
                self.error(error, f"[[{CLIENT}]] number {index + 1}", CLIENT, index)
            else:
                self.clients.append(table)


def _is_array_of_tables(value: Any) -> bool:
    return isinstance(value, list) and all(isinstance(each, dict) for each in value)


def _headers(names: Iterable[str]) -> str:
    return ", ".join([*(f"[{name}]" for name in names), f"[[{TRANSPORT}]]", f"[[{CLIENT}]]"])
