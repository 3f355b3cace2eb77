"""Message classes that reject assignments to unknown fields, for programs on virtual boards.

On MicroPython an assignment to a misspelt field makes a new attribute, and the field stays as it
was. The classes that `uros.boards.builder.file_system` makes with ``checked`` have the
``__setattr__`` of `checked` instead. A board's firmware usually has no ``__setattr__`` support, and
no memory for it.
"""

try:
    from typing import Any, Callable
except ImportError:  # MicroPython
    pass

_ALIKE = 6  # tenths of the letters that two similar names share in order
_MOST = 3  # similar names in an error
_LISTED = 8  # fields in an error when none is similar
_SHORT = 64  # letters of a name that are compared


def checked(type_name: str, names: "tuple[str, ...]", kind: str) -> "Callable[..., None]":
    """Return the ``__setattr__`` of a board's class.

    The function raises AttributeError for a name that is no field.

    Args:
        type_name: The name of the message type, for the error.
        names: The fields' attributes.
        kind: How the class stores the fields: ``""`` as attributes, ``"doubles"`` in an array,
            ``"halves"`` if ``sec`` is two attributes.
    """

    def assign(self: "Any", name: str, value: "Any") -> None:
        if name not in names and not (
            name[:1] == "_" or (kind == "halves" and name in ("high", "low"))
        ):
            raise AttributeError("%s has no field %s%s" % (type_name, name, meant(name, names)))
        # object.__setattr__ of MicroPython ignores properties.
        if kind == "doubles" and name in names:
            self._d[names.index(name)] = value
        elif kind == "halves" and name == "sec":
            object.__setattr__(self, "high", value >> 16)
            object.__setattr__(self, "low", value & 65535)
        else:
            object.__setattr__(self, name, value)

    return assign


def meant(name: str, names: "Any", inner: "Any" = ()) -> str:
    """Return the end of an error: ``inner`` and similar names, or else a list of all names."""
    close = [known for known in names if _share(name, known) >= _ALIKE]
    close.sort(key=lambda known: -_share(name, known))
    close = list(inner) + close
    if close:
        return "; did you mean %s?" % " or ".join(close[:_MOST])
    if not names:
        return "; it has none"
    listed = ", ".join(list(names)[:_LISTED])
    return "; it has %s%s" % (listed, ", ..." if len(names) > _LISTED else "")


def _share(a: str, b: str) -> int:
    """Return the share of letters that two names have in common, in the same order, in tenths."""
    a = a[:_SHORT].lower()
    b = b[:_SHORT].lower()
    row = [0] * (len(b) + 1)
    for letter in a:
        last = 0
        for i in range(len(b)):
            above = row[i + 1]
            row[i + 1] = last + 1 if letter == b[i] else max(above, row[i])
            last = above
    return 20 * row[-1] // (len(a) + len(b) or 1)
