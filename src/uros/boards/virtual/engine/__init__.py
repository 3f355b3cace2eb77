"""Runs a program on a virtual board, on CPython or MicroPython, in a process of its own.

=======================  =======================================================================
``console``              What a core prints, line by line
``cores``                A board's second core: the mailboxes between the cores, and
                         `engine_host` for them
``cpython``              Runs a board's program on CPython, next to the virtual hardware
``micropython``          Runs a board's program on MicroPython, as WebAssembly in a Node process
                         of its own
``peripheral_syscalls``  A firmware's UARTs, SPI buses, WLAN and sockets: `engine_host` for what
                         is plugged in
``pin_syscalls``         A firmware's pins, PWM, converters, interrupts and camera:
                         `engine_host` for what is on pins
``process``              A virtual board as a process: hardware, firmware and the hand that
                         plants faults
``runner``               Run a virtual board from Python: its firmware and hardware in a process
                         of their own
``syscalls``             What the firmware asks for, done on the virtual board: the host's side
                         of ``shims/_board.py``
=======================  =======================================================================
"""
