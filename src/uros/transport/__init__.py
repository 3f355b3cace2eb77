"""A board's ends of all transports. They run on MicroPython and on CPython.

===============  ===============================================================================
``at_modem``     What the board's ends of AT modems share: a dialogue that never waits, and a
                 queue to be sent
``can``          A board's end of CAN FD: one message in each frame. Runs on MicroPython
``can_host``     The port of a board's program that runs on CPython: a CAN interface, by python-
                 can
``can_pyb``      The port of a board's program whose CAN FD controller is a ``pyb.CAN``: STM32H7
                 and its like
``discovery``    A board that finds its agent by itself: it asks a multicast group, or addresses
                 that it knows
``esp8266``      A board's end of UDP through an ESP8266 or ESP32 with Espressif's AT firmware,
                 on a UART
``gs2200``       A board's end of UDP through a GainSpan GS2200 on SPI, the modem of Spresense's
                 Wi-Fi board
``serial``       A board's end of a serial line: frames over anything that reads and writes
                 bytes
``serial_host``  The port of a board's program that runs on CPython and is at a terminal: a
                 serial device
``tcp``          A board's end of TCP: each message behind its length
``tls``          A board's end of TCP in TLS. Runs on MicroPython ports that have a network and
                 ``ssl``
``udp``          A board's end of UDP. Runs on MicroPython ports that have a network
``wlan``         The network under a board's UDP or TCP: WLAN, as station or access point, and
                 Ethernet
===============  ===============================================================================

Modules whose name ends in ``_host`` are for CPython alone.
"""
