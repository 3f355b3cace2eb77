"""The virtual boards, a module each: which parts they have and how they are wired.

=====================  =========================================================================
``catalog``            The virtual boards by name
``esp32``              An ESP32-DevKitC on a breadboard, with LEDs, a button and a potentiometer
``ra6m5``              An EK-RA6M5: three I2C sensors in a room, native USB
``spresense``          An ESP32-S3-DevKitC-1 in place of a Sony Spresense, which has no
                       MicroPython
``spresense_sensors``  The board in place of a Spresense, carried outdoors: six I2C sensors and a
                       GNSS receiver
``sprturtlebot``       SprTurtleBot: the board in place of a Spresense on a rover, with motor
                       driver, encoders and camera
=====================  =========================================================================
"""
