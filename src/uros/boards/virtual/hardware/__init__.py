"""What every virtual board is made of: clock, pins, buses, USB.

===================  ===========================================================================
``board``            A virtual board: its hardware without a program, and its fault injection
``clock``            The time of a virtual board
``i2c``              An I2C bus: one controller, and devices that receive every byte
``parts``            The base class of all parts of a virtual board, and the list of them
``peripherals``      Peripherals that can be attached to a virtual board: a modem on a UART or an
                     SPI bus, or a radio
``pins``             Pins of a virtual board, and simple parts on them: LEDs, buttons and
                     potentiometers
``registers``        An I2C device with 8-bit registers behind a pointer
``resets``           Why the microcontroller was reset, its watchdog, and the memory that it keeps
``usb``              The board's USB device, and the host's port that it is connected to
``usb_descriptors``  USB descriptors of a serial port (CDC-ACM), and what a host checks in them
===================  ===========================================================================
"""
