"""Message classes that refuse fields which they do not have, for programs on virtual boards.

On MicroPython an assignment to a misspelt field makes a new attribute, and the field stays as it
was. The classes that `uros.boards.builder.file_system` makes with ``checked`` have the
``__setattr__`` of
`checked` instead. A board's firmware has no ``__setattr__`` as a rule, and no memory for it.
"""

try:
    from typing import Any, Callable
except ImportError:  # MicroPython
    pass

_ALIKE = 6  # tenths of their letters that two names share in order
_MOST = 3  # names that are told
_LISTED = 8  # fields that are told where none is alike
_SHORT = 64  # letters of a name that are compared


def checked(type_name: str, names: "tuple[str, ...]", kind: str) -> "Callable[..., None]":
    """The ``__setattr__`` of a board's class.

    Args:
        type_name: Of the message, for the error.
        names: The fields' attributes.
        kind: How the class keeps them: ``""`` as they are, ``"doubles"`` in an array, ``"halves"``
            where ``sec`` is two attributes.

    Raises AttributeError, when called, for a name that is none of them.
    """

    def assign(self: "Any", name: str, value: "Any") -> None:
        if name not in names and not (
            name[:1] == "_" or (kind == "halves" and name in ("high", "low"))
        ):
            raise AttributeError("%s has no field %s%s" % (type_name, name, meant(name, names)))
        # object.__setattr__ of MicroPython passes properties over.
        if kind == "doubles" and name in names:
            self._d[names.index(name)] = value
        elif kind == "halves" and name == "sec":
            object.__setattr__(self, "high", value >> 16)
            object.__setattr__(self, "low", value & 65535)
        else:
            object.__setattr__(self, name, value)

    return assign


def meant(name: str, names: "Any", inner: "Any" = ()) -> str:
    """The end of an error: which of ``names`` was meant, or ``inner``, or all that there are."""
    close = [it for it in names if _share(name, it) >= _ALIKE]
    close.sort(key=lambda it: -_share(name, it))
    close = list(inner) + close
    if close:
        return "; did you mean %s?" % " or ".join(close[:_MOST])
    if not names:
        return "; it has none"
    listed = ", ".join(list(names)[:_LISTED])
    return "; it has %s%s" % (listed, ", ..." if len(names) > _LISTED else "")


def _share(a: str, b: str) -> int:
    """How much of two names is the same letters in the same order, in tenths."""
    a = a[:_SHORT].lower()
    b = b[:_SHORT].lower()
    row = [0] * (len(b) + 1)
    for letter in a:
        last = 0
        for i in range(len(b)):
            here = row[i + 1]
            row[i + 1] = last + 1 if letter == b[i] else max(here, row[i])
            last = here
    return 20 * row[-1] // (len(a) + len(b) or 1)
