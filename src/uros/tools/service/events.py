"""Events of service introspection: their topics, and how they are printed.

A service whose introspection is enabled publishes ``service_msgs/msg/ServiceEventInfo`` with the
request or the response on the hidden topic ``NAME/_service_event``, at its clients and servers.
"""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING, Any, Final

from ..values import plain
from ..values.message_reader import MessageReader
from ..values.qos_subscribe import choose
from ..values.show_options import chosen_show
from ..values.yaml_text import Value, dump
from ..waiting import warn

if TYPE_CHECKING:
    from ...host.network import Network

PRESET: Final = "services_default"
"""The name of the profile with which ros2 subscribes to events."""

# By number, as in service_msgs/msg/ServiceEventInfo.
_EVENTS: Final = ("REQUEST_SENT", "REQUEST_RECEIVED", "RESPONSE_SENT", "RESPONSE_RECEIVED")


def event_topic(service: str) -> str:
    """Return the topic of a service's events."""
    return f"{service}/_service_event"


class EventPrinter:
    """Prints events and other messages as the options say."""

    def __init__(self, args: argparse.Namespace) -> None:
        self._csv = args.csv
        self._flow = args.flow_style
        self._show = chosen_show(args)

    def show(self, message: Any, head: str = "") -> None:
        """Print a message, unless it is None, with the lines of ``head`` in front of it."""
        if message is not None:
            text = f"{plain.csv(message, self._show)}\n" if self._csv else self._yaml(message)
            sys.stdout.write(head + text)
            sys.stdout.flush()

    def _yaml(self, message: Any) -> str:
        value = plain.plain(message, self._show)
        info = value.get("info")
        if isinstance(info, dict) and message._TYPE.endswith("_Event"):
            info["event_type"] = _event_name(message.info.event_type)
        return f"{dump(value, self._flow)}---\n"


def _event_name(number: int) -> Value:
    return _EVENTS[number] if number < len(_EVENTS) else number


def listen_to_events(
    network: Network,
    args: argparse.Namespace,
    service: str,
    type_name: str,
    printer: EventPrinter,
    head: str = "",
) -> bool:
    """Subscribe to the events of a service, and print them.

    Args:
        network: The domain, which has been discovered.
        args: The command line, with the QoS options.
        service: The service's full name.
        type_name: The service's type.
        printer: Prints the events.
        head: Lines in front of each event.

    Returns:
        Whether an event publisher is there.

    Raises:
        InterfaceError: The type has no definition.
    """
    from ...interfaces import load

    kind = load(f"{type_name}_Event")
    topic = event_topic(service)
    offered = [publisher.qos for publisher in network.graph.publishers(topic)]
    qos, notes = choose(args, offered)
    for note in notes:
        warn(f"{topic}: {note}")
    read = MessageReader(kind).read
    network.listen(topic, kind._TYPE, qos, lambda got: printer.show(read(got.cdr), head))
    return bool(offered)
