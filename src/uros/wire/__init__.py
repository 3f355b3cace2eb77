"""DDS-XRCE wire protocol: bytes in, bytes out. No I/O and no clock.

Everything here runs unchanged on CPython and on MicroPython; both the client and the agent are
built on it. Modules, from the bottom up:

============  ====================================================================================
``ids``       Numbers that the specification assigns: submessages, object kinds, statuses.
``errors``    The family of errors that bytes from a peer can raise.
``cdr``       Primitive values in CDR, with its alignment.
``header``    Message and submessage headers.
``session``   CREATE_CLIENT, STATUS, INFO, HEARTBEAT, ACKNACK, TIMESTAMP and their like.
``entities``  CREATE and the three representations of an entity.
``data``      READ_DATA, WRITE_DATA, DATA.
``streams``   Streams: sequence numbers, windows, retransmission, fragments.
``framing``   Frames for serial lines, length prefixes for TCP.
============  ====================================================================================

Source: OMG DDS-XRCE 1.0 (formal/20-02-01). Where eProsima's client 2.x and agent 2.x differ from
it, their behaviour on the wire is followed and noted.
"""
