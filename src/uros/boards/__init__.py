"""Boards: the builder of their file systems, deployment on real ones, virtual ones.

============  ==================================================================================
``builder``   Builds the file system of a board from a program and what it imports of uros
``deploy``    Puts a built program on a real board, and shows its console
``template``  The program with which a new project begins
``virtual``   Virtual boards: hardware, devices and their world, and engines that run firmware
============  ==================================================================================
"""
