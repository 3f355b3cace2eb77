"""YAML of bags, read and written by PyYAML within limits."""

from __future__ import annotations

from typing import Any, Final

from .errors import BagError

MAX_TEXT: Final = 64 << 20
"""Largest text in bytes: a bag of 100,000 files has a tenth of this. Attack: memory."""


def load(text: str | bytes, where: str) -> Any:
    """Return the value of a YAML document.

    Args:
        text: The document.
        where: The file, for the error.

    Raises:
        BagError: The text is too large, or no YAML.
    """
    import yaml

    if len(text) > MAX_TEXT:
        raise BagError(f"{where}: over {MAX_TEXT} bytes; this is no metadata of a bag")
    try:
        return yaml.load(text, getattr(yaml, "CSafeLoader", yaml.SafeLoader))
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark
        line = f"line {mark.line + 1}: " if mark else ""
        raise BagError(f"{where}: {line}no YAML ({error.problem})") from error
    # Values that PyYAML cannot make: dates, numbers, keys; brackets in brackets.
    except (yaml.YAMLError, ValueError, TypeError, OverflowError, RecursionError) as error:
        raise BagError(f"{where}: no YAML ({error})") from error


def dump(value: object) -> str:
    """Return a value as YAML text, mappings in their order."""
    import yaml

    dumper = getattr(yaml, "CSafeDumper", yaml.SafeDumper)
    text: str = yaml.dump(value, Dumper=dumper, sort_keys=False, default_flow_style=False)
    return text
