"""DDS-XRCE on the wire: bytes in, bytes out. No I/O and no clock.

Everything here runs unchanged on CPython and on MicroPython; both the client
and the agent are built on it. Modules, from the bottom up:

==============  ================================================================
``ids``         numbers the specification assigns (submessages, kinds, statuses)
``errors``      the one family of errors that bytes from a peer can raise
``cdr``         primitive values, aligned as CDR wants them
``header``      message and submessage headers
``session``     CREATE_CLIENT, STATUS, INFO, HEARTBEAT, ACKNACK, TIMESTAMP …
``entities``    CREATE and the three representations of an entity
``data``        READ_DATA, WRITE_DATA, DATA
``streams``     sequence numbers, windows, resends, fragments
``framing``     frames for serial lines, length prefixes for TCP
==============  ================================================================

Source: OMG DDS-XRCE 1.0 (formal/20-02-01); where eProsima's client 2.x and
agent 2.x differ from it, what they do on the wire is followed and noted.
"""
