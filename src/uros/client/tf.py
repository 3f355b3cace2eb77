"""Transform broadcasters for ``/tf`` and ``/tf_static``, as in tf2_ros.

::

    broadcaster = TransformBroadcaster(node)
    transform = TransformStamped()        # geometry_msgs
    transform.header.frame_id, transform.child_frame_id = "odom", "base_link"
    node.clock.stamp(transform.header.stamp)
    broadcaster.sendTransform(transform)

``tf2_msgs`` is not needed on the board: the message is encoded from the transforms.
"""

from ..qos import DurabilityPolicy, QoSProfile
from .latched_publisher import create_latched

try:
    from typing import Any, Final
except ImportError:  # MicroPython
    pass

_TRANSFORM: Final = "geometry_msgs/msg/TransformStamped"
# Default of tf2_ros.
_DEPTH: Final = 100


class Transforms:
    """A ``tf2_msgs/msg/TFMessage`` of generated TransformStamped messages, to be sent."""

    _TYPE = "tf2_msgs/msg/TFMessage"
    _DDS_TYPE = "tf2_msgs::msg::dds_::TFMessage_"

    def __init__(self, transforms: "list[Any]") -> None:
        self.transforms = transforms

    def cdr_size(self, o: int = 0) -> int:
        """Return the offset behind the message if it begins at offset ``o``."""
        o = (o + 3 & -4) + 4
        for transform in self.transforms:
            o = transform.cdr_size(o)
        return o

    def pack_into(self, buf: "Any", offset: int, start: int) -> int:
        """Encode the message at ``buf[offset:]``, aligned from ``start``; return where it ends."""
        while (offset - start) & 3:
            buf[offset] = 0
            offset += 1
        count = len(self.transforms)
        for _ in range(4):
            buf[offset] = count & 0xFF
            count >>= 8
            offset += 1
        for transform in self.transforms:
            offset = transform.pack_into(buf, offset, start)
        return offset


class TransformBroadcaster:
    """Publishes the transforms of moving frames on ``/tf``."""

    def __init__(self, node: "Any", qos: "Any" = _DEPTH) -> None:
        self.publisher = node.create_publisher(Transforms, "/tf", qos)

    def sendTransform(self, transform: "Any") -> bool:
        """Send a transform, or a list of them in one message; return False if it was dropped."""
        return self.publisher.publish(Transforms(_listed(transform)))  # type: ignore[no-any-return]


class StaticTransformBroadcaster:
    """Publishes the transforms of static frames on ``/tf_static``.

    Each message has all of them, and it is sent again to each new agent. A transform replaces an
    earlier one with the same child frame. Copies are kept, so the program may change its messages.
    """

    def __init__(self, node: "Any", qos: "Any" = None) -> None:
        if qos is None:
            qos = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._transforms: "list[Any]" = []
        self.publisher = create_latched(node, Transforms, "/tf_static", qos)
        self.publisher.on_connected = self._send

    def sendTransform(self, transform: "Any") -> bool:
        """Keep a transform, or a list of them, and send all that are kept.

        Returns:
            False if they are sent later: there is no agent, or the send queue is full.
        """
        for message in _listed(transform):
            octets = bytearray(message.cdr_size())
            message.pack_into(octets, 0, 0)
            copy = type(message).unpack_from(octets, 0, 0, len(octets))[0]
            others = [
                item for item in self._transforms if item.child_frame_id != copy.child_frame_id
            ]
            self._transforms = others + [copy]
        sent = self._send()
        if not sent and self.publisher.created:
            self.publisher.call_in()
        return sent

    def _send(self) -> bool:
        return not self._transforms or self.publisher.publish(Transforms(self._transforms))


def _listed(transform: "Any") -> "list[Any]":
    """Return the transforms as a list.

    Raises:
        TypeError: An item is no transform.
    """
    out = transform if isinstance(transform, (list, tuple)) else [transform]
    for item in out:
        if getattr(item, "_TYPE", "") != _TRANSFORM:
            raise TypeError("%r is no %s" % (item, _TRANSFORM))
    return list(out)
