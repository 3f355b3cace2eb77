"""Transports of boards, for MicroPython and CPython.

===============  ===============================================================================
``at_modem``     Base class of transports over AT modems: a non-blocking dialogue and a send
                 queue
``can``          CAN FD: one message in each frame
``can_host``     Port of ``can`` on CPython: a CAN interface, by python-can
``can_pyb``      Port of ``can`` on ``pyb.CAN`` with CAN FD, such as the STM32H7's
``discovery``    Discovery of the agent, by multicast or from a list of addresses
``esp8266``      UDP through an ESP8266 or ESP32 with Espressif's AT firmware, on a UART
``gs2200``       UDP through a GainSpan GS2200 on SPI, the modem of Spresense's Wi-Fi board
``serial``       Serial line: frames on anything that reads and writes bytes
``serial_host``  Port of ``serial`` on CPython: a serial device
``tcp``          TCP: each message behind its length
``tls``          TCP in TLS, on MicroPython ports that have a network and ``ssl``
``udp``          UDP, on MicroPython ports that have a network
``wlan``         The network under UDP or TCP: WLAN, as station or access point, and Ethernet
===============  ===============================================================================

Modules whose name ends in ``_host`` are for CPython alone.
"""
