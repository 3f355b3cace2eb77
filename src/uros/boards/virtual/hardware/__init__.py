"""What every virtual board is made of: clock, pins, buses, USB.

===================  ===========================================================================
``board``            A virtual board: its hardware without a program, and what can be done to it
``clock``            The time of a virtual board
``i2c``              An I2C bus: one controller, and devices that hear every byte
``parts``            What every part of a virtual board has in common, and the world that they
                     share
``peripherals``      What can be plugged into a virtual board: a modem on a UART or an SPI bus,
                     or a radio
``pins``             Pins of a virtual board, and the simplest things on them: LEDs, buttons, a
                     knob
``registers``        An I2C device that is a row of registers of eight bits behind a pointer
``usb``              The board's USB device, and the host's port that it is plugged into
``usb_descriptors``  USB descriptors of a serial port (CDC-ACM), and what a host checks in them
===================  ===========================================================================
"""
