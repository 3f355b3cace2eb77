"""The ROS 2 node that runs on a board: an XRCE session, entities, an executor.

Everything here runs unchanged on CPython and on MicroPython. Modules, from the bottom up:

==============  ================================================================
``clock``       the board's ticks, and epoch time learnt from the agent
``session``     one XRCE session: bytes in, bytes out, no I/O
``connection``  the transport, the four states, entities created again and again
``executor``    timers and callbacks, in order, with triggers
``entities``    publisher, subscription, service, client
``node``        the Node that makes them
==============  ================================================================
"""

from .connection import (
    AGENT_AVAILABLE,
    AGENT_CONNECTED,
    AGENT_DISCONNECTED,
    WAITING_AGENT,
)
from .node import Node

__all__ = ["AGENT_AVAILABLE", "AGENT_CONNECTED", "AGENT_DISCONNECTED", "WAITING_AGENT", "Node"]
