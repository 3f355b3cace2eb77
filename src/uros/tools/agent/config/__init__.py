"""The configuration file of ``uros agent``.

===========  ===================================================================================
``check``    ``uros agent check``: tells what is wrong with a configuration file
``faults``   What a configuration contradicts or lacks on this machine
``running``  Finds the agents that run with a configuration file
``file``     Reads a configuration file; collects all its mistakes, with their lines
``schema``   The tables and keys of a configuration file, which are the options of the command line
===========  ===================================================================================
"""
