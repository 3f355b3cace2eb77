"""Virtual boards: hardware, devices and their world, and engines that run firmware.

============  ==================================================================================
``devices``   Sensors, motors and cameras of virtual boards, each as its data sheet has it
``engine``    Runs a program on a virtual board, on CPython or MicroPython, in a process of its
              own
``hardware``  What every virtual board is made of: clock, pins, buses, USB
``models``    The virtual boards, a module each: which parts they have and how they are wired
``modems``    Radio modems of virtual boards, and the network behind them
``shims``     What a virtual board has built in for its firmware: ``machine``, ``time``,
              ``select``, ``usb``
``world``     What sensors, cameras and rovers of virtual boards are in
============  ==================================================================================
"""
