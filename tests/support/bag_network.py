"""A network for ``uros bag``, whose topics and messages the test makes."""

from types import SimpleNamespace

from uros.host.network import Received

STRING = "std_msgs/msg/String"


class Writer:
    """A writer that notes what it writes."""

    def __init__(self, written, topic):
        self._written = written
        self._topic = topic

    def write(self, cdr):
        self._written.append((self._topic, bytes(cdr)))
        return True


class Network:
    """Has the members of ``uros.host.network.Network`` that recording and playing use.

    Each :meth:`spin` calls the next function of ``script``.

    Attributes:
        log: The subscriptions: (topic, profile), and (topic, None) when one ends.
        writers: The profiles of writers by DDS name of the topic.
        written: (DDS name of the topic, sample).
    """

    domain = 0
    alone = False

    def __init__(self, *script):
        self.changed_at = 0
        self.offers = {}
        self.readers = {}
        self.types = {}
        self.listening = {}
        self.log = []
        self.graph = self
        self.node = self
        self.script = list(script)
        self.writers = {}
        self.written = []

    def publish(self, topic, *profiles, types=(STRING,), type_hash="INVALID"):
        """Have a topic with a publisher of each profile."""
        self.changed_at += 1
        self.types[topic] = list(types)
        self.offers[topic] = [
            SimpleNamespace(gid=b"%d" % number, qos=qos, type_hash=type_hash)
            for number, qos in enumerate(profiles)
        ]

    def topics(self):
        return self.types

    def publishers(self, topic):
        return self.offers[topic]

    def subscriptions(self, topic):
        return self.readers.get(topic, [])

    def listen(self, topic, type_name, qos, on_sample):
        self.listening[topic] = on_sample
        self.log.append((topic, qos))

        def end():
            self.log.append((topic, None))

        return end

    def send(self, topic, cdr=b"\0\1\0\0", at=50, sent=40):
        """Deliver a message to the subscription."""
        self.listening[topic](Received(cdr, sent, at))

    def create_writer(self, topic, type_name, qos):
        self.writers[topic] = qos
        return Writer(self.written, topic)

    def spin(self, done, seconds=None):
        if self.script:
            self.script.pop(0)()

    def settle(self, seconds=0.0):
        pass

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass
