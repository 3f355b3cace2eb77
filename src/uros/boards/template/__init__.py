"""The program with which a board's new project begins; ``uros board new`` writes it.

===========  ===================================================================================
``project``  Writes the folder of a new program: its files are the ``.txt`` files of this folder
===========  ===================================================================================
"""
