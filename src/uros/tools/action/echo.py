"""``uros action echo``: print the messages of an action: its feedback, its status, its services.

The requests and responses of its services are published only if the introspection of the action's
client or server is enabled.
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any, Final

from ..common import add_action, add_common, discover, join
from ..errors import UsageError, did_you_mean
from ..graph_types import only_type, types_of
from ..service.events import PRESET, EventPrinter, listen_to_events
from ..values.message_reader import MessageReader
from ..values.qos_subscribe import add_qos_arguments
from ..values.show_options import add_show_arguments
from ..values.typed_values import load_action
from ..waiting import warn
from .goal import service_of

if TYPE_CHECKING:
    from ...host.network import Network

# The names that ros2 gives to the services and topics of an action.
_SERVICES: Final = {
    "GOAL_SERVICE": ("send_goal", "SendGoalService"),
    "CANCEL_SERVICE": ("cancel_goal", "CancelGoalService"),
    "RESULT_SERVICE": ("get_result", "GetResultService"),
}
_TOPICS: Final = {
    "FEEDBACK_TOPIC": ("feedback", "FeedbackMessage"),
    "STATUS_TOPIC": ("status", "GoalStatusMessage"),
}
_ALL: Final = (*_SERVICES, *_TOPICS)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros action echo``."""
    add_action(parser)
    parser.add_argument(
        "type", metavar="TYPE", nargs="?",
        help="type of the action, such as test_msgs/action/Fibonacci (default: the action's type)",
    )  # fmt: skip
    parser.add_argument(
        "-i", "--action-interfaces", metavar="NAMES",
        help=f"print only these, with | between them: {', '.join(_ALL)}; --interfaces takes these"
        " names too",
    )  # fmt: skip
    add_common(parser)
    add_show_arguments(parser)
    add_qos_arguments(parser, PRESET)


def run(args: argparse.Namespace) -> int:
    """Print messages until Ctrl-C.

    Raises:
        ToolError: There is no such action, or it has several types.
        UsageError: There is no such service or topic of an action.
    """
    chosen = _chosen(args)
    printer = EventPrinter(args)
    try:
        with join(args) as network:
            given = None if args.type is None else load_action(args.type)
            discover(network, args)
            kind = given or load_action(_type(network, args.action))
            _listen(network, args, kind, printer, chosen)
            network.spin(lambda: False)
    except KeyboardInterrupt:
        pass  # the usual end
    return 0


def _chosen(args: argparse.Namespace) -> list[str]:
    """Return the names to print. ros2's ``--interfaces`` is our folder of definitions."""
    texts = [] if args.action_interfaces is None else [args.action_interfaces]
    for folder in list(args.interfaces):
        if all(name.strip().upper() in _ALL for name in folder.split("|")):
            args.interfaces.remove(folder)
            texts.append(folder)
    names = [name.strip().upper() for text in texts for name in text.split("|")]
    for name in names:
        if name not in _ALL:
            raise UsageError(
                f"--action-interfaces: {name!r} is none of {', '.join(_ALL)}"
                f"{did_you_mean(name, _ALL)}"
            )
    return names or list(_ALL)


def _type(network: Network, action: str) -> str:
    types = types_of(network, "action", action, network.graph.actions())
    return only_type("action echo", action, types)


def _listen(
    network: Network, args: argparse.Namespace, kind: Any, printer: EventPrinter, chosen: list[str]
) -> None:
    from ...qos import QoSProfile, qos_profile_action_status_default

    silent = []
    for name in chosen:
        head = f"interface: {name}\n"
        if name in _SERVICES:
            service, attribute = _SERVICES[name]
            type_name = getattr(kind.Impl, attribute)._TYPE
            if not listen_to_events(
                network, args, service_of(args.action, service), type_name, printer, head
            ):
                silent.append(name)
            continue
        topic, attribute = _TOPICS[name]
        message = getattr(kind.Impl, attribute)
        qos = qos_profile_action_status_default if name == "STATUS_TOPIC" else QoSProfile(10)
        read = MessageReader(message).read
        network.listen(
            f"{args.action}/_action/{topic}", message._TYPE, qos,
            lambda got, read=read, head=head: (  # type: ignore[misc]
                printer.show(read(got.cdr), head)
            ),
        )  # fmt: skip
    if silent:
        warn(
            f"nobody publishes {' and '.join(silent)} of {args.action}: is the introspection of the"
            " action's client or server enabled?"
        )
