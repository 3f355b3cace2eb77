"""``uros board``: a module for each verb.

================  ================================================================================
``board_option``  The option ``--board``: the real board that a program is for
``build``         ``uros board build``
``console``       ``uros board console``, which is also how ``uros board deploy`` ends: what a
                  board prints
``deploy``        ``uros board deploy``
``index``         ``uros board index``
``list``          ``uros board list``
``run``           ``uros board run``
``screen``        Where a session with boards is shown: lines as they come, and on a terminal a
                  table above them
``simulation``    Virtual boards, the agent for them, and the person at the terminal: one session
================  ================================================================================
"""
