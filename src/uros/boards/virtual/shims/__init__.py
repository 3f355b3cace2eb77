"""The built-in modules of a virtual board's firmware: ``machine``, ``time``, ``select``, ``usb``.

These modules run on MicroPython and on CPython, inside the firmware's engine. They reach the
virtual hardware through ``_board`` alone. Host programs never import them.
"""
