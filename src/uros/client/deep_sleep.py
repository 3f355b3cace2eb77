"""Deep sleep between messages, without becoming another client.

::

    if wait_for_agent(node, 10.0):
        publisher.publish(message)
    deep_sleep(node, 600000)

A board that wakes starts its program anew. Its client key is derived from its own id and the node's
name, and its first session has the same id each time: the agent goes on with the objects that it
has, so other nodes of ROS do not see the board leave and come back. What they send meanwhile waits
at the agent, as much as the QoS of the subscription keeps, and is delivered after the next start.

The agent deletes a client that is silent for its ``--dead-time``, 300 s if not given: for longer
sleeps give it a longer one.
"""

from ..ticks import ticks_add, ticks_diff
from .connection import AGENT_CONNECTED

try:
    from typing import Any, Final
except ImportError:  # MicroPython
    pass

_ROUND_S: Final = 0.05


def wait_for_agent(node: "Any", timeout_sec: float) -> bool:
    """Spin until the node is connected; return whether it is.

    Args:
        node: The node.
        timeout_sec: Most seconds to wait.
    """
    end = ticks_add(node.clock.ms(), int(timeout_sec * 1000))
    while node.state != AGENT_CONNECTED and ticks_diff(end, node.clock.ms()) > 0:
        node.spin_once(_ROUND_S)
    return bool(node.state == AGENT_CONNECTED)


def deep_sleep(node: "Any", sleep_ms: int, timeout_sec: float = 2.0) -> None:
    """Sleep by ``machine.deepsleep``, once the agent has what was published. Does not return.

    Without an agent the board sleeps at once; what the agent has not acknowledged is lost.

    Args:
        node: The node; it is spun until all its messages are acknowledged.
        sleep_ms: How long to sleep, in milliseconds.
        timeout_sec: Most seconds to wait for the acknowledgements.
    """
    connection = node.connection
    end = ticks_add(node.clock.ms(), int(timeout_sec * 1000))
    if connection.state == AGENT_CONNECTED:
        connection.pause_reading()
    while (
        connection.state == AGENT_CONNECTED
        and connection.held()
        and ticks_diff(end, node.clock.ms()) > 0
    ):
        node.spin_once(_ROUND_S)
    import machine  # type: ignore[import-not-found]

    machine.deepsleep(sleep_ms)
