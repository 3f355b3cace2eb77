"""Faults of interface definitions and of serialized messages.

One family, so that a caller needs one ``except``::

    ValueError
    └── InterfaceError          this module: bad .msg text, unknown type, hostile CDR bytes,
                                a value that does not fit its field

A value of the wrong *type* (a ``str`` in an ``int32``) is a ``TypeError``, as everywhere in Python.
The module runs on MicroPython.
"""

# A board's build says False: a class costs it 100 bytes.
_OWN_CLASS = True

if _OWN_CLASS:

    class InterfaceError(ValueError):
        """A definition, a value or bytes of a message break the rules; the text says where."""

else:
    InterfaceError = ValueError  # type: ignore[misc,assignment]
