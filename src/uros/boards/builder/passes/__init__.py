"""The passes of the builder, each a module; `uros.boards.builder.pipeline` lists them in order.

==================  ============================================================================
``strip``           Translates modules of uros for MicroPython; every build does it
``terse_errors``    Shortens errors, and omits comparing and printing messages
``constants``       Replaces the names of constants by their values, across modules
``tree_shake``      Drops the code that a program does not reach, by names
``bundle``          Joins the modules of uros and of interfaces into one
``link_imports``    Lets modules import from the bundle itself, without a re-exporting module
``merge_classes``   Merges a base class with its only subclass
``inline_methods``  Replaces the only call of a method by the body of the method
``mangle``          Renames names that no module outside of the bundle uses to names in
                    MicroPython's ROM, or to shorter ones
``order_names``     Gives the names used most the shortest numbers in the bundle's bytecode
==================  ============================================================================
"""
