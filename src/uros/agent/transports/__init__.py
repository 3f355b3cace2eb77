"""The agent's transports: servers that listen for boards, and the modules below them.

===================  ============================================================
``base``             the contract of an agent's transport
``udp``              UDP over IPv4 and IPv6
``tcp``              TCP over IPv4 and IPv6
``ip``               sockets and addresses that UDP and TCP share
``tls``              TCP in TLS
``certificates``     the certificates and keys that TLS needs
``x509``             dates and serial numbers of certificates and revocation lists
``discovery``        answers boards that search for an agent
``line``             frames in a stream of bytes, and a line that reconnects
``line_faults``      explains bytes of a line among which no frame is
``serial``           serial devices and pseudo-terminals, by termios
``serial_device``    a serial device by its name, or by a file with the name
``terminal``         opens a device and its modem lines
``baud``             baud rates, also those that termios does not name
``portable_serial``  serial devices and URLs, by pyserial
``multiserial``      several serial devices in one agent
``sockets``          serial lines over stream sockets
``rfcomm``           Bluetooth, over RFCOMM
``can``              CAN FD, by python-can
``custom``           transports that users write
``worker``           threads for lines whose calls may block
``fault_counter``    counts faults of a transport and limits their log lines
``remedies``         what the errno of a line means, and what to do
``memory``           boards and agent in one process, for tests
===================  ============================================================
"""
