"""Subscribes to the selected topics of a network and hands their messages to a cache."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from ... import names
from ...bag.metadata import TopicMetadata
from .definition_search import DefinitionSearch
from .message_cache import MessageCache, Recorded
from .selection import Selection

if TYPE_CHECKING:
    from ...host.graph_queries import EndpointInfo
    from ...host.network import Network, Received
    from ...qos import QoSProfile
    from .status_line import StatusLine

CLOCK: Final = "/clock"
CLOCK_TYPE: Final = "rosgraph_msgs/msg/Clock"
# For the messages that come while the program does something else, such as looking at the graph.
_DEPTH: Final = 10000


@dataclass
class _Subscription:
    """A topic that is recorded.

    Attributes:
        metadata: The topic, for the bag.
        qos: The subscription's profile.
        end: Ends it.
        has_publishers: Whether the profile was adapted to publishers.
        known: The publishers whose profiles were looked at.
    """

    metadata: TopicMetadata
    qos: QoSProfile
    end: Callable[[], None]
    has_publishers: bool
    known: set[bytes] = field(default_factory=set)


class Recorder:
    """The subscriptions of a recording.

    Args:
        network: The network.
        selection: The topics.
        cache: Takes topics and messages.
        console: Tells what is recorded.
        overrides: The subscriptions' profiles by topic, in place of adapted ones.
        unpublished: Whether topics without a publisher are recorded.
        ignore_leaves: Whether topics without a subscription are not.
        use_sim_time: Whether messages get the time of ``/clock``; those before its first message
            are not recorded.

    Attributes:
        paused: Whether messages are dropped.
        received: The messages that were handed over.
        octets: Their octets.
    """

    def __init__(
        self,
        network: Network,
        selection: Selection,
        cache: MessageCache,
        console: StatusLine,
        overrides: Mapping[str, QoSProfile],
        *,
        unpublished: bool = False,
        ignore_leaves: bool = False,
        use_sim_time: bool = False,
    ) -> None:
        self._network = network
        self._selection = selection
        self._cache = cache
        self._console = console
        self._overrides = overrides
        self._unpublished = unpublished
        self._ignore_leaves = ignore_leaves
        self._clock_ns: int | None = None
        self._use_sim_time = use_sim_time
        self._subscriptions: dict[str, _Subscription] = {}
        self._warned: set[str] = set()
        self._looked_at: float | None = None
        self._search = DefinitionSearch(network)
        # The topics of each type that nodes are asked for, and the definitions that they gave.
        self._undefined: dict[str, list[TopicMetadata]] = {}
        self._definitions: dict[str, str] = {}
        self.paused = False
        self.received = 0
        self.octets = 0
        if use_sim_time:
            self._listen_to_clock()

    @property
    def topics(self) -> int:
        """The number of topics that are recorded."""
        return len(self._subscriptions)

    def _listen_to_clock(self) -> None:
        from ...interfaces import InterfaceError, codec, load
        from ...qos import QoSProfile, ReliabilityPolicy

        clock = load(CLOCK_TYPE)

        def on_sample(received: Received) -> None:
            try:
                now = codec.from_cdr(clock, received.cdr).clock
            except InterfaceError:
                return
            if self._clock_ns is None:
                self._console.say(f"{CLOCK} was found")
                self._looked_at = None
            self._clock_ns = now.sec * 10**9 + now.nanosec

        best_effort = QoSProfile(1, ReliabilityPolicy.BEST_EFFORT)
        self._network.listen(CLOCK, CLOCK_TYPE, best_effort, on_sample)
        self._console.say(f"waiting for {CLOCK}")

    def discover(self) -> None:
        """Subscribe to selected topics that have appeared, and adapt to publishers that have."""
        changed_at = self._network.changed_at
        if changed_at == self._looked_at or (self._use_sim_time and self._clock_ns is None):
            return
        self._looked_at = changed_at
        for topic, types in self._network.graph.topics().items():
            subscription = self._subscriptions.get(topic)
            if subscription is not None:
                self._adapt(subscription, self._network.graph.publishers(topic))
            elif self._is_meant(topic, types):
                self._subscribe(topic, types[0], self._network.graph.publishers(topic))

    def _is_meant(self, topic: str, types: Sequence[str]) -> bool:
        if not any(self._selection.takes(topic, type_name) for type_name in types):
            return False
        if not self._unpublished and not self._network.graph.publishers(topic):
            return False
        if self._ignore_leaves and not self._network.graph.subscriptions(topic):
            return False
        fault = names.fault(topic)
        if len(types) > 1:
            fault = f"it has several types: {', '.join(types)}"
        elif not fault and "\\" in types[0]:  # as it is escaped
            fault = f"its type {types[0]} is not a name"
        if fault:
            self._warn_once(topic, f"{topic} is not recorded: {fault}")
        return not fault

    def _warn_once(self, about: str, text: str) -> None:
        if about not in self._warned:
            self._warned.add(about)
            self._console.warn(text)

    def _subscribe(self, topic: str, type_name: str, publishers: Sequence[EndpointInfo]) -> None:
        from ...bag.definitions import definition_text, topic_type_hash

        announced = {info.type_hash for info in publishers if info.type_hash.startswith("RIHS")}
        metadata = TopicMetadata(
            topic,
            type_name,
            [info.qos for info in publishers],
            announced.pop() if len(announced) == 1 else topic_type_hash(type_name),
            self._definitions.get(type_name) or definition_text(type_name),
        )
        if self._is_asked_for(metadata, publishers):
            self._cache.hold(metadata)
        else:
            self._cache.add_topic(metadata)
        qos = self._profile(topic, publishers)
        self._subscriptions[topic] = _Subscription(
            metadata,
            qos,
            self._listen(metadata, qos),
            bool(publishers),
            {info.gid for info in publishers},
        )
        self._console.say(f"Subscribed to topic '{topic}'")

    def _is_asked_for(self, topic: TopicMetadata, publishers: Sequence[EndpointInfo]) -> bool:
        """Return whether nodes are asked for the definition of a topic's type."""
        from ..type_lookup import is_asked_for

        name = topic.type_name
        if topic.definition or name in self._definitions or not is_asked_for(name, publishers):
            return False
        if name not in self._undefined:
            if not self._search.begin(name):
                return False
            self._undefined[name] = []
        self._undefined[name].append(topic)
        return True

    def look_up(self, now: float) -> None:
        """Go on asking nodes for definitions; ``now`` in seconds.

        What a topic has meanwhile is held by the cache, and written when the definition has come,
        or none will come.
        """
        for found in self._search.turn(now):
            self._definitions[found.type_name] = found.text
            if found.text:
                self._console.say(f"Definition of {found.type_name} from {found.node}")
            else:
                self._console.warn(
                    f"the bag has no definition of {found.type_name}: {found.fault}; give the"
                    " folder of its package: --interfaces DIR"
                )
            for topic in self._undefined.pop(found.type_name):
                topic.definition = found.text
                self._cache.add_topic(topic)

    def _profile(self, topic: str, publishers: Sequence[EndpointInfo]) -> QoSProfile:
        """Return a profile that all publishers match."""
        from ...host.matching import adapt
        from ...qos import QoSProfile

        if topic in self._overrides:
            return self._overrides[topic]
        profile = QoSProfile(_DEPTH)
        for note in adapt(profile, [info.qos for info in publishers]):
            self._warn_once(topic + note, f"{topic}: {note}")
        return profile

    def _adapt(self, subscription: _Subscription, publishers: Sequence[EndpointInfo]) -> None:
        """Subscribe anew if a publisher has come that does not match."""
        fresh = [info for info in publishers if info.gid not in subscription.known]
        if not fresh:
            return
        subscription.known = {info.gid for info in publishers}
        metadata, before = subscription.metadata, subscription.qos
        metadata.offered_qos += [info.qos for info in fresh if info.qos not in metadata.offered_qos]
        qos = self._profile(metadata.name, publishers)
        if qos is before:  # overridden
            return
        if subscription.has_publishers and not (
            (before.reliable and not qos.reliable)
            or (before.transient_local and not qos.transient_local)
            or before.partitions != qos.partitions
        ):
            return
        subscription.has_publishers = True
        subscription.end()
        subscription.qos = qos
        subscription.end = self._listen(metadata, qos)

    def _listen(self, metadata: TopicMetadata, qos: QoSProfile) -> Callable[[], None]:
        def on_sample(received: Received) -> None:
            now_ns = self._clock_ns if self._use_sim_time else received.received_ns
            if self.paused or now_ns is None:
                return
            self.received += 1
            self.octets += len(received.cdr)
            self._cache.add(Recorded(metadata, received.cdr, now_ns, received.source_ns or now_ns))

        return self._network.listen(metadata.name, metadata.type_name, qos, on_sample)

    def missing(self) -> list[str]:
        """Return the names that were asked for and that are not in the graph."""
        return self._selection.missing(self._network.graph.topics())

    def close(self) -> None:
        """End all subscriptions and questions; idempotent."""
        self._search.close()
        while self._subscriptions:
            self._subscriptions.popitem()[1].end()
