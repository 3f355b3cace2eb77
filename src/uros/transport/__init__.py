"""A board's ends of all transports. They run on MicroPython and on CPython.

===================  ============================================================
``stream``           serial lines: frames over anything that reads and writes bytes
``datagram``         UDP
``tcpboard``         TCP; ``tlsboard``: TCP in TLS
``discoveryboard``   finds the agent for these
``wlan``             the network below all four: WLAN and Ethernet
``esp8266``          UDP through an ESP8266 with AT firmware
``gs2200``           UDP through a GainSpan GS2200
``modem``            what these two share
``canboard``         CAN FD; ``canpyb``: its port on an STM32
``device``           the port of a serial device, on a host
``canport``          the port of a CAN interface, on a host
===================  ============================================================
"""
