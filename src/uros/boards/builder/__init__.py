"""Builds the file system of a board from a program and what it imports of uros.

==================  ============================================================================
``field_check``     Finds fields of messages that a program names and their types do not have
``foreign_names``   The names that are MicroPython's own, and those of what boards' firmware
                    brings
``pipeline``        The passes of a build: what is done to uros's modules, in this order
``portable``        Names the modules of uros that boards may have: the one place that knows
``resolver``        Makes a board's file system: a program, and of uros and the ROS interfaces
                    what it imports
``type_inference``  Infers which expressions of a program are messages, and of which type
``passes``          The passes of the builder, each a module; `uros.boards.builder.pipeline`
                    lists them
==================  ============================================================================
"""
