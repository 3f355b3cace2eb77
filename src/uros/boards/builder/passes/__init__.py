"""The passes of the builder, each a module; `uros.boards.builder.pipeline` lists them in order.

==================  ============================================================================
``strip``           Translates modules of uros for MicroPython; every build does it
``terse_errors``    Leaves out what only says more about an error
``constants``       Puts the values of named constants where their names stand, across modules
``tree_shake``      Drops what a program does not reach, by names
``bundle``          Puts the modules of uros and of interfaces into one
``link_imports``    Lets modules import from the bundle itself, not by a module in between
``merge_classes``   Makes one class of a base and its only subclass
``inline_methods``  Puts the body of a method where its only call stands
``mangle``          Gives names that nobody outside of the bundle can see the names that
                    MicroPython has in its ROM
``order_names``     Gives the names used most the shortest numbers in the bundle's bytecode
==================  ============================================================================
"""
