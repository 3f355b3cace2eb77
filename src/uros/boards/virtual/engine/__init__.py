"""Runs a program on a virtual board, on CPython or MicroPython, in a process of its own.

=======================  =======================================================================
``advice``               What a virtual board has, for a program that asks for something else
``console``              Splits a core's output into lines
``cores``                A board's second core: the mailboxes between the cores, and their
                         system calls
``cpython``              Runs a board's program on CPython, in the process of the hardware
``micropython``          Runs a board's program on MicroPython, as WebAssembly in a Node process
                         of its own
``peripheral_syscalls``  System calls for UARTs, SPI buses, WLAN and sockets
``pin_syscalls``         System calls for pins, PWM, converters, interrupts and the camera
``process``              A virtual board as a process: hardware, firmware and fault injection
``runner``               Runs a virtual board from Python, in a process of its own
``syscalls``             The system calls of the firmware, carried out on the virtual board: the
                         host's side of ``shims/_board.py``
``testing``              A virtual board with an agent and a node, for tests of programs
=======================  =======================================================================
"""
