"""The ROS 2 node that runs on a board: an XRCE session, entities, an executor.

Everything here runs unchanged on CPython and on MicroPython. Modules, from the bottom up:

==============  ================================================================
``clock``       the board's ticks, and epoch time learnt from the agent
``session``     one XRCE session: bytes in, bytes out, no I/O
``connection``  the transport, the four states, entities created again and again
``executor``    timers and callbacks, in order, with triggers
``entities``    publisher, subscription, service, client
``node``        the Node that makes them
``protocols``   what these need of each other, for type checkers
==============  ================================================================

What not every program needs is in modules of its own, which cost nothing where they are not
imported:

==============  ================================================================
``triggers``    when a round of callbacks begins: all, one, always
``let``         logical execution time, and rounds in fixed periods
``guard``       guard conditions
``aio``         ``await node.spin()``, among other tasks of asyncio
``remap``       remapping rules, node options from a file
``graph``       who is there, as far as the agent tells
``parameters``  a node's parameters: their values (``parameter``), the services
                that show them (``parameter_services``), and a file that keeps
                them (``parameter_file``)
``rosout``      a node's log; ``logger_service`` sets its levels from afar
``lifecycle``   nodes that others bring up and shut down
``tf``          broadcasters of transforms
``shapes``      messages without classes, for what these services say
``status``      an LED, and words, for whether there is an agent
``latch``       a publisher that speaks again to each new agent
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
