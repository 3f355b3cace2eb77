"""``uros completion``: completion of command lines in bash, zsh and fish.

===========  =====================================================================================
``command``  ``uros completion``: print the shell's function; print what may come next, for it
``names``    Values of arguments: topics, nodes, types and other names
``details``  Values that depend on one before: parameters, transitions, fields
``shells``   The functions of the shells, and the form in which they take candidates
``words``    Finds the argument that the last word of a command line belongs to
===========  =====================================================================================
"""
