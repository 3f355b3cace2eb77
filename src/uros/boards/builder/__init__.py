"""Builds the file system of a board from a program and what it imports of uros.

===================  ===========================================================================
``file_system``      Makes a board's file system: resolves, checks, runs the passes, compiles,
                     writes
``output``           Writes the folder of a build, whole or not at all
``cache``            Keeps the files of builds, for virtual boards
``resolver``         Finds what a program imports: its own modules, those of uros, and types of
                     interfaces
``portable``         Defines which modules of uros boards may have
``modules``          A module of a board's file system, its imports and the names others refer to
``scopes``           Finds which names code binds, and which of them an inner scope hides
``pipeline``         The passes of a build over uros's modules, in their order
``passes``           The passes of the builder, each a module
``secrets_file``     The module ``secrets`` of a board, which is no part of a build
``compiler``         Compiles modules to MicroPython's bytecode, by mpy-cross
``field_check``      Finds fields of messages that a program names and their types do not have
``inferred_values``  The values of expressions, and what follows from one
``type_inference``   Infers which expressions of a program are messages, and of which type
``foreign_names``    The names that MicroPython and the firmware of boards define
``errors``           The errors of a build
===================  ===========================================================================
"""
