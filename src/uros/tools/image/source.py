"""Subscribes to a topic with images, compressed or raw, with the QoS of its publishers."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final

from ...dashboard.pictures import TYPES, Picture, PictureError, picture

if TYPE_CHECKING:
    from ...host.network import Network, Received

# One image may wait while another is decoded; older ones are of no use.
_DEPTH: Final = 2


class ImageSource:
    """A subscription of images. Call `check` about once a second, and spin the network between.

    Args:
        network: The domain.
        topic: The topic.
        on_picture: Called with each image and the time of reception (Unix ns).
        on_trouble: Called with the reason why an image cannot be shown.
    """

    def __init__(
        self,
        network: Network,
        topic: str,
        on_picture: Callable[[Picture, int], object],
        on_trouble: Callable[[str], object],
    ) -> None:
        self._network = network
        self._topic = topic
        self._on_picture = on_picture
        self._on_trouble = on_trouble
        self._heard: dict[str, tuple[object, Callable[[], None]]] = {}
        self.octets = 0  # of messages, as they came

    def check(self) -> str:
        """Subscribe to the present publishers. Return why no image can come, or nothing."""
        from ...host.matching import adapt
        from ...qos import QoSProfile, ReliabilityPolicy

        graph = self._network.graph
        publishers = graph.publishers(self._topic)
        for type_name in TYPES:
            offered = [
                publisher.qos for publisher in publishers if publisher.type_name == type_name
            ]
            if not offered:
                self._end(type_name)
                continue
            qos = QoSProfile(_DEPTH, ReliabilityPolicy.BEST_EFFORT)
            adapt(qos, offered)
            manner = qos.reliable, qos.transient_local, qos.partitions
            if self._heard.get(type_name, (None,))[0] != manner:
                self._end(type_name)
                self._listen(type_name, qos, manner)
        if self._heard:
            return ""
        return self._why_nothing({publisher.type_name for publisher in publishers})

    def _why_nothing(self, types: set[str]) -> str:
        if types:
            return (
                f"{self._topic} is {' and '.join(sorted(types))}, which is not an image; supported"
                f" are {' and '.join(TYPES)}"
            )
        text = f"nobody publishes {self._topic} yet"
        topics = self._network.graph.topics()
        others = sorted(name for name, has in topics.items() if set(has) & set(TYPES))
        others = [name for name in others if self._network.graph.publishers(name)]
        if others:
            return f"{text}; there are images on {', '.join(others[:5])}"
        if self._network.alone:
            return (
                f"{text}: no other participant was found in domain {self._network.domain}; is the"
                " agent running, and the board in this domain?"
            )
        return f"{text}: is the board connected, and its camera on?"

    def _listen(self, type_name: str, qos: Any, manner: object) -> None:
        from ...interfaces import InterfaceError, codec, load

        message_class: Any = load(type_name)

        def heard(received: Received) -> None:
            self.octets = len(received.cdr)
            try:
                shown = picture(codec.from_cdr(message_class, received.cdr))
            except PictureError as error:
                self._on_trouble(f"an image cannot be shown: {error}")
            except InterfaceError as error:
                self._on_trouble(f"a message cannot be read: {error}")
            else:
                self._on_picture(shown, received.received_ns)

        self._heard[type_name] = manner, self._network.listen(self._topic, type_name, qos, heard)

    def _end(self, type_name: str) -> None:
        heard = self._heard.pop(type_name, None)
        if heard is not None:
            heard[1]()


def add_image_topic(parser: Any) -> None:
    """Declare the positional argument ``topic``."""
    from ..common import topic_name

    parser.add_argument(
        "topic",
        metavar="TOPIC",
        nargs="?",
        type=topic_name,
        default="/image/compressed",
        help="topic of CompressedImage (JPEG, PNG) or Image (default: /image/compressed)",
    )


def age(stamp_ns: int, received_ns: int) -> str:
    """Return how old an image was when it came, by its stamp."""
    if not stamp_ns:
        return "not stamped"
    seconds = (received_ns - stamp_ns) / 1e9
    if seconds < -0.05:
        return f"{_span(-seconds)} in the future: two clocks differ"
    if seconds > 86400:
        return f"{_span(seconds)} old: the sender's clock is not set"
    return f"{_span(max(0.0, seconds))} old"


def _span(seconds: float) -> str:
    for unit, length in (("d", 86400), ("h", 3600), ("min", 60)):
        if seconds >= 2 * length:
            return f"{seconds / length:.0f} {unit}"
    return f"{seconds * 1000:.0f} ms" if seconds < 1 else f"{seconds:.1f} s"
