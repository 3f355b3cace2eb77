"""A domain whose graph the test makes, for the verbs that list it or listen to its topics."""

from contextlib import nullcontext

from uros.host import network as network_module
from uros.host.graph_queries import Graph


class GraphNetwork:
    """Has the members of ``uros.host.network.Network`` that these verbs use.

    Each :meth:`spin` calls the next function of ``script``; behind the last one it is interrupted,
    as by Ctrl-C.

    Args:
        source: What has the graph, such as ``Net`` of ``unit/host/test_graph_queries.py``.

    Attributes:
        listening: What receives the samples of each subscription, by topic.
        waited: The seconds that each `spin` was given.
    """

    domain = 0
    alone = False
    overflowed = False

    def __init__(self, source):
        self.graph = Graph(source)
        self.script = []
        self.listening = {}
        self.waited = []
        self.samples_lost = 0

    def listen(self, topic, type_name, qos, on_sample):
        self.listening[topic] = on_sample
        return lambda: self.listening.pop(topic)

    def lost(self):
        return self.samples_lost

    def settle(self, seconds=0.0):
        pass

    def spin(self, done, seconds=None):
        self.waited.append(seconds)
        if done():
            return True
        if not self.script:
            raise KeyboardInterrupt
        self.script.pop(0)()
        return done()

    def join(self, monkeypatch):
        """Have every verb join this domain; return it."""
        monkeypatch.setattr(network_module, "Network", lambda *_: nullcontext(self))
        return self
