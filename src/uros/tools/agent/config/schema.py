"""The tables and keys of a configuration file, which are the options of the command line.

Nothing is listed twice: keys, values and their checks are those of the parsers of ``uros agent``.
An option's key is the long option with ``_`` in place of ``-``, except for those in :data:`_KEYS`.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Iterable
from typing import Any, Final

from ....agent.policy.config_values import ConfigError, Faults, listed, shown, table_of
from ....agent.transports.serial_device import is_path
from ..options.group import OptionGroup
from ..options.transports import TRANSPORTS

# The keys of options whose table says a part of their names already.
_KEYS: Final = {
    "allow_key": "keys",
    "allow_net": "networks",
    "capture": "file",
    "capture_size": "size",
    "audit": "file",
    "audit_size": "size",
}
# The option that names the file has no place in the file.
_NOT_IN_FILE: Final = ("config",)


def _remappings(value: Any) -> Any:
    """Return ``{ "/old" = "/new" }`` as the texts of the command line."""
    if not isinstance(value, dict):
        return value
    return [f"{old}:={new}" for old, new in value.items()]


def _policies(value: Any) -> Any:
    """Return ``{ "/odom" = { depth = 1 } }`` as the texts of the command line."""
    if not isinstance(value, dict):
        return value
    return [
        f"{topic}:" + ",".join(f"{name}={policy}" for name, policy in table_of(each, topic).items())
        for topic, each in value.items()
    ]


def _keys(value: Any) -> Any:
    """Return client keys, which may be numbers, as texts."""
    return [
        str(key) if isinstance(key, int) and not isinstance(key, bool) else key
        for key in listed(value)
    ]


def _words(value: Any) -> list[Any]:
    """Return the devices in one value, which the C++ agent has separated by spaces."""
    return value.split() if isinstance(value, str) else [value]


def _on_off(value: Any) -> Any:
    return {True: "on", False: "off"}[value] if isinstance(value, bool) else value


# Values that a TOML file can say better than the command line.
_FORMS: Final[dict[str, Callable[[Any], Any]]] = {
    "remap": _remappings, "qos": _policies, "allow_key": _keys, "dtr": _on_off, "rts": _on_off,
}  # fmt: skip


class Key:
    """A key of a table: an option of the command line.

    Attributes:
        name: The key.
        attribute: The attribute of the parsed option.
        option: The option's longest form, for messages; the key if it is a positional argument.
        is_file: Whether its value is the path of a file, or several.
        is_device: Whether its value is a serial device, or several.
    """

    def __init__(self, action: argparse.Action) -> None:
        self.attribute = action.dest
        self.name = _KEYS.get(action.dest, action.dest)
        self.option = max(action.option_strings, key=len, default=self.name)
        self.is_file = action.metavar == "FILE"
        self.is_device = action.metavar == "DEVICE"
        self.required = action.required
        self.default = action.default
        self._action = action

    def parse(self, value: Any, folder: str) -> Any:
        """Return the value as the command line's parser would.

        Args:
            value: The value in the file.
            folder: The folder that relative paths of files and devices start from.

        Raises:
            ConfigError: The value is not valid, or several of a list are not.
        """
        action = self._action
        if self.attribute in _FORMS:
            value = _FORMS[self.attribute](value)
        if action.nargs == 0:
            if not isinstance(value, bool):
                raise ConfigError(f"{self.name} is {shown(value)}, not true or false")
            return value
        if action.nargs == "?" and isinstance(value, bool):
            return action.const if value else None
        if isinstance(action, argparse._AppendAction) or action.nargs == "+":
            values = listed(value)
            if self.is_device:
                values = [word for each in values for word in _words(each)]
            if not values:
                raise ConfigError(f"{self.name} is empty: leave it out")
            parsed = []
            faults = Faults()
            for each in values:
                with faults.at():
                    parsed.append(self._one(each, folder))
            faults.check()
            return parsed
        return self._one(value, folder)

    def _one(self, value: Any, folder: str) -> Any:
        parse = self._action.type
        text = value
        if parse is not None and isinstance(value, (int, float)) and not isinstance(value, bool):
            text = str(value)
        if not isinstance(text, str) or not text:
            kind = "text" if parse is None else "number or a text"
            raise ConfigError(f"{self.name} is {shown(value)}, not a {kind}")
        if self._action.choices is not None and text not in self._action.choices:
            from ...errors import did_you_mean

            choices = list(map(str, self._action.choices))
            close = did_you_mean(text, choices)
            raise ConfigError(
                f"{self.name} is {text!r}{close or ', not one of ' + ', '.join(choices)}"
            )
        if self.is_file or (self.is_device and is_path(text)):
            return os.path.join(folder, text)
        if not callable(parse):
            return text
        try:
            return parse(text)
        except argparse.ArgumentTypeError as error:
            raise ConfigError(f"{self.name}: {error}") from error
        except ValueError as error:
            raise ConfigError(f"{self.name} is {shown(value)}, not a number") from error


class TransportKeys:
    """The keys of a ``[[transport]]`` table.

    Attributes:
        keys: The keys by name, without ``type``.
        exclusive: Groups of keys of which only one may be given, and whether one must be.
    """

    def __init__(self, name: str) -> None:
        parser = argparse.ArgumentParser(add_help=False)
        TRANSPORTS[name].add_options(parser)
        self.keys = {key.name: key for key in map(Key, parser._actions)}
        self.exclusive = [
            ([Key(action).name for action in group._group_actions], group.required)
            for group in parser._mutually_exclusive_groups
        ]


def tables(groups: Iterable[OptionGroup]) -> dict[str, dict[str, Key]]:
    """Return the keys of the agent's tables, by the names of table and key.

    Args:
        groups: The options of the agent.
    """
    found: dict[str, dict[str, Key]] = {}
    for group in groups:
        parser = argparse.ArgumentParser(add_help=False)
        group.declare(parser)
        keys = [Key(action) for action in parser._actions if action.dest not in _NOT_IN_FILE]
        found.setdefault(group.table, {}).update({key.name: key for key in keys})
    return found
