"""ROS 2 node of a board: XRCE session, entities, executor.

All modules run unchanged on CPython and on MicroPython. From the lowest layer up:

==============  ==================================================================================
``clock``       The board's ticks, and epoch time synchronized with the agent.
``session``     One XRCE session: bytes in, bytes out, no I/O.
``connection``  The transport, the connection's four states, and creation of the entities.
``executor``    Timers and callbacks, in order, with triggers.
``entities``    Publisher, subscription, service, client.
``node``        The Node, which makes entities, timers and guard conditions.
``protocols``   What node, connection and transport need of each other, for type checkers.
==============  ==================================================================================

Optional features are separate modules, which take memory only if imported:

==========================  ======================================================================
``triggers``                When the executor runs its callbacks: all ready, one ready, always.
``logical_execution_time``  Logical execution time, and execution in fixed periods.
``guard_condition``         Guard conditions.
``asyncio_support``         ``await node.spin()``, beside other tasks of asyncio.
``remap``                   Remapping rules, and node options from a file.
``graph``                   Graph queries: nodes, topics and endpoints that the agent knows.
``actions``                 Publishers and services of an action, common to client and server.
``action_client``           Action client.
``action_server``           Action server.
``parameter``               Types, values and descriptors of parameters.
``parameters``              The parameters of a node: declaration, checks, callbacks.
``parameter_services``      The six parameter services, and ``/parameter_events``.
``parameter_file``          Parameter values kept in a file.
``rosout``                  Logging to ``/rosout``.
``logger_service``          Services that get and set the levels of loggers.
``lifecycle``               Managed (lifecycle) nodes.
``tf``                      Transform broadcasters.
``float64``                 Exact float64 fields on boards whose floats have 32 bits.
``streaming``               Messages sent in pieces, longer than the board's memory.
``dynamic_messages``        Messages without generated classes, for the services above.
``deep_sleep``              Deep sleep between messages, without becoming another client.
``status``                  State of the connection as text, and on an LED.
``latched_publisher``       A publisher that repeats its last message to each new agent.
==========================  ======================================================================
"""

from .connection import (
    AGENT_AVAILABLE,
    AGENT_CONNECTED,
    AGENT_DISCONNECTED,
    WAITING_AGENT,
)
from .node import Node

__all__ = ["AGENT_AVAILABLE", "AGENT_CONNECTED", "AGENT_DISCONNECTED", "WAITING_AGENT", "Node"]
