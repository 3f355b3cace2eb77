"""Listens to ``/tf`` and ``/tf_static`` of a domain."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from .frames import FrameTree, Stamped
from .transforms import Transform, fault, normalized

if TYPE_CHECKING:
    from ...host.network import Network, Received

_TYPE: Final = "tf2_msgs/msg/TFMessage"
_TOPICS: Final = {"/tf": False, "/tf_static": True}
# As tf2_ros.
_DEPTH: Final = 100
# The middleware of the tools for transforms: it tells who has written a sample.
MIDDLEWARE: Final = "rtps"


class Listener:
    """Collects transforms while the network spins.

    Attributes:
        tree: The frames.

    Args:
        network: The domain.
    """

    def __init__(self, network: Network) -> None:
        from ...interfaces import load
        from ...qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

        self.tree = FrameTree()
        self._network = network
        self._type = load(_TYPE)
        for topic, is_static in _TOPICS.items():
            qos = QoSProfile(_DEPTH, ReliabilityPolicy.BEST_EFFORT)
            if is_static:
                qos = QoSProfile(_DEPTH, durability=DurabilityPolicy.TRANSIENT_LOCAL)
            network.listen(
                topic, _TYPE, qos,
                lambda received, is_static=is_static: self._heard(received, is_static),  # type: ignore[misc]
            )  # fmt: skip

    def _heard(self, received: Received, is_static: bool) -> None:
        from ...interfaces.codec import from_cdr
        from ...interfaces.errors import InterfaceError

        try:
            message = from_cdr(self._type, received.cdr)
        except InterfaceError as error:
            self.tree.refuse("", f"a message cannot be read: {error}")
            return
        for each in message.transforms:
            pose = _pose(each.transform)
            why = fault(pose)
            if why:
                self.tree.refuse(each.child_frame_id, why)
                continue
            stamp = each.header.stamp
            self.tree.add(
                each.header.frame_id,
                each.child_frame_id,
                Stamped(
                    Transform(pose.translation, normalized(pose.rotation)),
                    stamp.sec * 1_000_000_000 + stamp.nanosec,
                ),
                received.received_ns,
                is_static,
                received.writer,
            )

    def broadcasters(self) -> dict[bytes, str]:
        """Return the full names of the nodes that publish transforms, by the GUID of the writer."""
        from ... import names

        return {
            publisher.gid: names.join(publisher.node_namespace, publisher.node_name)
            for topic in _TOPICS
            for publisher in self._network.graph.publishers(topic)
        }


def _pose(message: Any) -> Transform:
    """Return a ``geometry_msgs/msg/Transform``."""
    move, turn = message.translation, message.rotation
    return Transform((move.x, move.y, move.z), (turn.x, turn.y, turn.z, turn.w))
