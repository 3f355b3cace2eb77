"""A network for ``uros bag``, whose topics and messages the test makes."""

from types import SimpleNamespace

from uros.host.network import Received
from uros.interfaces import load
from uros.interfaces.codec import from_cdr, to_cdr

STRING = "std_msgs/msg/String"
DESCRIPTION = "type_description_interfaces/srv/GetTypeDescription"
HASH = "RIHS01_" + "0" * 64


class Asked:
    """The requester of a client of a service; the test answers by `Network.answer`."""

    def __init__(self, network, service):
        self.service = service
        self.requests = []
        self.replies = {}
        self.closed = False
        self._network = network

    def servers(self):
        return int(self.service not in self._network.unmatched)

    def request(self, cdr):
        self.requests.append(from_cdr(load(DESCRIPTION).Request, bytes(cdr)))
        return len(self.requests)

    def take(self, limit):
        taken, self.replies = self.replies, {}
        return taken.items()

    def refusal(self):
        return ""

    def close(self):
        self.closed = True


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
        clients: The clients of services, in the order of their creation.
        unmatched: The services whose servers do not match.
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
        self.offered_services = {}
        self.clients = []
        self.unmatched = set()

    def publish(self, topic, *profiles, types=(STRING,), type_hash="INVALID", nodes=("talker",)):
        """Have a topic with a publisher of each profile in each node."""
        self.changed_at += 1
        self.types[topic] = list(types)
        self.offers[topic] = [
            SimpleNamespace(
                gid=b"%d%s" % (number, node.encode()), qos=qos, type_hash=type_hash,
                type_name=types[0], node_namespace="/", node_name=node,
            )
            for node in nodes
            for number, qos in enumerate(profiles)
        ]  # fmt: skip

    def describe(self, *nodes):
        """Have nodes that can be asked for definitions."""
        self.changed_at += 1
        for node in nodes:
            self.offered_services[f"/{node}/get_type_description"] = [DESCRIPTION]

    def services(self):
        return self.offered_services

    def servers(self, service):
        return self.offered_services.get(service, [])

    def create_requester(self, service, qos, on_ready):
        name = service.request_topic.removeprefix("rq").removesuffix("Request")
        self.clients.append(Asked(self, name))
        return self.clients[-1]

    def answer(self, client, text, successful=True, name=""):
        """Answer the last request of a client with the text of the message's file."""
        kind = load(DESCRIPTION)
        name = name or client.requests[-1].type_name
        response = kind.Response(successful=successful)
        response.type_description.type_description.type_name = name
        source = load("type_description_interfaces/msg/TypeSource")
        response.type_sources = [source(type_name=name, encoding="msg", raw_file_contents=text)]
        client.replies[len(client.requests)] = to_cdr(response)

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
        return done()

    def settle(self, seconds=0.0):
        pass

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass
