"""Virtual boards: hardware, devices and their world, and engines that run firmware.

============  ==================================================================================
``devices``   Sensors, motors and cameras of virtual boards, modelled after their data sheets
``engine``    Runs a program on a virtual board, on CPython or MicroPython, in a process of its
              own
``hardware``  What every virtual board is made of: clock, pins, buses, USB
``models``    The virtual boards, a module each: which parts they have and how they are wired
``modems``    Radio modems of virtual boards, and the network behind them
``shims``     The built-in modules of a virtual board's firmware: ``machine``, ``time``,
              ``select``, ``usb``
``world``     The environments of virtual boards: what sensors measure, cameras see and rovers
              drive in
============  ==================================================================================
"""
