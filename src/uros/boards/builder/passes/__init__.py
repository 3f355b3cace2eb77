"""The passes of the builder, each a module; `uros.boards.builder.pipeline` lists them.

==================  ============================================================================
``bundle``          Puts the modules of uros and of interfaces into one
``inline_methods``  Puts the body of a method where its only call stands
``link_imports``    Lets modules take their names from the bundle itself, not by a module in
                    between
``mangle``          Gives names that nobody outside of the bundle can see the names that
                    MicroPython has in its ROM
``merge_classes``   Makes one class of a base and its only heir, where nothing but the heir
                    names the base
``order_names``     Gives the names that stand in most places the shortest numbers in the
                    bundle's bytecode
``strip``           Makes modules of uros smaller for a board, without a change of what they do
                    there
``terse_errors``    Leaves out of uros's modules, for a board, what only says more about an
                    error
``tree_shake``      Drops what a board's program does not reach, by names
==================  ============================================================================
"""
