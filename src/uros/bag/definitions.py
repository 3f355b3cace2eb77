"""The definitions of a type and all its nested types as one text, as bags carry them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from ..interfaces import InterfaceError, registry
from .errors import BagError

_SEPARATOR: Final = "=" * 80 + "\n"


def definition_text(type_name: str) -> str:
    """Return the definitions of a type and its nested types in the encoding ``ros2msg``.

    The root's text comes first; each nested type follows once, behind a line of ``=`` and a line
    with its name (``MSG: std_msgs/Header``), as the profile ``ros2`` of MCAP says.

    Args:
        type_name: A message type, such as ``std_msgs/msg/String``.

    Returns:
        The text; empty if uros knows no definition of the type.
    """
    try:
        root = registry.definition(type_name)
        nested = {} if len(root.parts) != 1 else registry.closure(root.parts[0])
        names = [type_name, *nested]
        if any(registry.file_type(name) != name for name in names) or len(root.parts) != 1:
            return ""
        texts = [registry.source(name)[0] for name in names]
    except InterfaceError:
        return ""
    return joined(dict(zip(names, texts, strict=True)))


def joined(texts: Mapping[str, str]) -> str:
    """Return the definitions of a message and of those that it nests as one text.

    Args:
        texts: The text of each by its type; the root comes first.
    """
    parts: list[str] = []
    for name, text in texts.items():
        package, _, plain = name.split("/")
        parts.append(f"\n{_SEPARATOR}MSG: {package}/{plain}\n{text}" if parts else text)
    return "".join(parts)


def topic_type_hash(type_name: str) -> str:
    """Return the RIHS01 hash of a type, empty if uros knows no definition of it.

    Raises:
        BagError: ROS_DISTRO names no distribution.
    """
    from ..interfaces import distro, known_hash

    try:
        return (known_hash(type_name) or "") if distro.has_hashes() else ""
    except InterfaceError as error:
        raise BagError(str(error)) from error
