"""``uros board``: a module for each verb.

================  ================================================================================
``board_option``  The option ``--board``: the real board that a program is for
``build``         ``uros board build``: build a program for a board
``connections``   Which virtual boards are connected to an agent, as the running agents report
``console``       ``uros board console``: show the console of a real board, as ``deploy`` does at
                  its end
``deploy``        ``uros board deploy``: deploy a program to a real board and show its console
``index``         ``uros board index``: build a package index for MicroPython's mip
``list``          ``uros board list``: list virtual boards, and real ones that can run uros
``new``           ``uros board new``: begin a program for a board
``run``           ``uros board run``: run virtual boards with their firmware
``screen``        Prints lines, and on a terminal a table of boards above them
``simulation``    Runs virtual boards and an agent for them, and executes typed commands
``stubs``         ``uros board stubs``: write type stubs for editors
================  ================================================================================
"""
