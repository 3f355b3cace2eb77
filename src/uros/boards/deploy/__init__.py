"""Deploys a built program to a real board, and shows its console.

================  ==============================================================================
``console``       Extracts the text of a board's console line for a terminal, without the XRCE
                  frames in between
``deploy``        Copies a built file system to a board by the raw REPL of its console
``frozen``        Writes what MicroPython's build needs to freeze modules into a firmware
``known_boards``  Boards on the market, and the MicroPython port of each, or why it has none
``literal``       Reads a value that a board printed by ``repr``
``mip``           Writes what MicroPython's package installer, ``mip``, needs to install uros
``mpy_abi``       Which bytecode a board's firmware loads
``raw_repl``      Runs code on a board by MicroPython's raw REPL on its console line
================  ==============================================================================
"""
