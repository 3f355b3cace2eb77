"""The virtual boards, a module each: which parts they have and how they are wired.

=====================  =========================================================================
``catalog``            The virtual boards that there are, by name
``esp32``              An ESP32-DevKitC on a breadboard: an LED at pin 22, a button or a second
                       LED at pin 23, a knob at pin 34, and a USB adapter at UART 2, or its own
                       WLAN
``ra6m5``              An EK-RA6M5: three I2C sensors in a room, USB of its own
``spresense``          An ESP32-S3-DevKitC-1 that stands for a Sony Spresense, which has no
                       MicroPython: its four LEDs, the line to the agent at UART 1, and what
                       else a program needs
``spresense_sensors``  The board that stands for a Spresense, carried around outdoors: six
                       sensors on I2C channel 0 and a receiver of satellites at UART 2
``sprturtlebot``       SprTurtleBot: the board that stands for a Spresense on a rover, with its
                       driver, encoders and camera
=====================  =========================================================================
"""
