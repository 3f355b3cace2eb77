"""Puts a built program on a real board, and shows its console.

================  ==============================================================================
``console``       What a board's console line carries, for a terminal: text, without the XRCE
                  frames in between
``deploy``        Puts a built file system on a board, by the raw REPL of its console
``known_boards``  Boards that there are to buy, and the MicroPython port that each has, or why
                  it has none
``literal``       Reads a value that a board printed by ``repr``
``mip``           What MicroPython's package installer, ``mip``, needs to put uros on a board
``raw_repl``      MicroPython's raw REPL: runs code on a board by the line of its console
================  ==============================================================================
"""
