"""``uros plot``: plot numbers of topics in the terminal.

===========  =====================================================================================
``chart``    Draws series of numbers with braille dots
``command``  ``uros plot``: plot fields of topics
``field``    Finds the number in a message that a path names
===========  =====================================================================================
"""
