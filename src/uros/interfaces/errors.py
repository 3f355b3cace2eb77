"""Errors of interface definitions and of serialized messages.

All derive from one class, so that a caller needs one ``except``::

    ValueError
    └── InterfaceError          bad .msg text, unknown type, malformed CDR bytes,
                                a value that does not fit its field

A value of the wrong *type* (a ``str`` in an ``int32``) is a ``TypeError``, as everywhere in Python.
The module runs on MicroPython.
"""

# A board's build sets False: a class takes 100 bytes there.
_OWN_CLASS = True

if _OWN_CLASS:

    class InterfaceError(ValueError):
        """A definition, a value or the bytes of a message are invalid; the text says where."""

else:
    InterfaceError = ValueError  # type: ignore[misc,assignment]
