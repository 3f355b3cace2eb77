"""What a virtual board has built in for its firmware: ``machine``, ``time``, ``select``, ``usb``.

These modules run on MicroPython and on CPython, inside the firmware's engine. Everything they do
goes through ``_board`` to the virtual hardware. Hosts never import them.
"""
