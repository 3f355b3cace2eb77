"""The only code that opens sockets, serial lines and CAN; both ends of each.

The agent's ends:

===================  ============================================================
``base``             the contract of an agent's transport
``udp``, ``tcp``     over IPv4 and IPv6; ``ip`` is what they share
``tls``              TCP in TLS; ``certificates``: the files it needs
``discovery``        how boards find the agent; ``addresses``: this machine's
``line``             frames in a stream of bytes, and a line that comes back
``serial``           devices and pseudo-terminals, by termios
``terminal``         opening a device and its modem lines; ``baud``: its rates
``portable_serial``  devices and URLs, by pyserial
``multiserial``      several devices in one agent
``sockets``          lines that are stream sockets; ``rfcomm``: Bluetooth
``can``              CAN FD, by python-can
``custom``           what users write
``worker``           threads for lines whose calls may wait
``tally``            faults are counted, and told seldom
``remedies``         what the errno of a line means, and what to do
``memory``           boards and agent in one process
``http``             metrics and pages: who may ask, how many, how long
===================  ============================================================

A board's ends, which run on MicroPython: ``stream`` for lines, ``datagram`` for UDP,
``tcpboard`` for TCP, ``tlsboard`` for TLS, ``discoveryboard``, which finds the agent for these, and
``wlan``, the network under all four;
``esp8266`` and ``gs2200`` for AT modems, and ``modem``, what these share; ``canboard`` for CAN FD
and ``canpyb``, its port on an STM32. Where a board's program runs on CPython, ``device``,
``portable_serial`` and ``canport`` are the ports.
"""
