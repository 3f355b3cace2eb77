"""The environment of a vehicle: an agent process, the links to it, and a ROS node on DDS.

:func:`support.autopilot.until` serves them all while a test waits.
"""

import os
import subprocess
import sys
import threading
import time
import tty
from collections import defaultdict

from support.autopilot import SECONDS, SerialLink, UdpLink, until
from support.middleware import MIDDLEWARE

# --- the agent -------------------------------------------------------------------------------


class AgentProcess:
    """A process of ``uros agent ...``; ``lines`` has its output."""

    def __init__(self, *arguments, environment=None):
        self.lines = []
        self.port = 0
        self._news = threading.Condition()
        self._process = subprocess.Popen(
            [sys.executable, "-m", "uros", "agent", *map(str, arguments)],
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
            env={**os.environ, **(environment or {})},
        )  # fmt: skip
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()
        try:
            running = self.wait_for("running...")
        except BaseException:
            self.kill()
            raise
        if "port: " in running:
            self.port = int(running.split("port: ")[1].split()[0])

    def _read(self):
        for line in self._process.stdout:
            with self._news:
                self.lines.append(line.rstrip("\n"))
                self._news.notify_all()
        with self._news:
            self._news.notify_all()

    def said(self, text):
        with self._news:
            return [line for line in self.lines if text in line]

    def wait_for(self, text, seconds=SECONDS):
        """The first line with ``text`` in it."""
        end = time.monotonic() + seconds
        with self._news:
            while True:
                matching = [line for line in self.lines if text in line]
                if matching:
                    return matching[0]
                left = end - time.monotonic()
                assert left > 0 and self._thread.is_alive(), (text, self.lines)
                self._news.wait(left)

    def kill(self):
        """Kill the process, as a crash or a power cut does."""
        self._process.kill()
        self._finish()

    def _finish(self):
        self._process.wait(SECONDS)
        self._thread.join(SECONDS)
        self._process.stdout.close()

    def close(self):
        """Terminate the process and check its exit status."""
        if self._process.returncode is None:
            self._process.terminate()
            try:
                self._finish()
            except subprocess.TimeoutExpired:
                self.kill()
            assert self._process.returncode == 0, self.lines

    def __enter__(self):
        return self

    def __exit__(self, kind, *_):
        self.close()
        if kind is None:
            assert not self.said("internal error") and not self.said("Traceback"), self.lines


class Terminal:
    """A serial line: ``device`` is the agent's end; the other end is the vehicle's."""

    def __init__(self):
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        self.device = os.ttyname(self._slave)

    def link(self):
        return SerialLink(self._master)

    def close(self):
        os.close(self._master)
        os.close(self._slave)


class Place:
    """An agent on a transport, and the links to it. The agent can be stopped and started again."""

    def __init__(self, transport, domain, *arguments, environment=None):
        self.transport = transport
        self._terminal = Terminal() if transport == "serial" else None
        self._arguments = ["-m", MIDDLEWARE, *arguments]
        if domain is not None:
            self._arguments += ["--domain", domain]
        self._environment = environment
        self._port = 0
        self._links = []
        self._vehicles = []
        self._looked_at = 0
        self.agent = None
        self.start()

    def start(self):
        if self._terminal is not None:
            line = ("serial", "-D", self._terminal.device, "-b", 921600)
        else:
            line = ("udp4", "-p", self._port)
        self.agent = AgentProcess(*line, *self._arguments, environment=self._environment)
        self._port = self.agent.port

    def link(self):
        """A new socket, or the vehicle's UART."""
        link = UdpLink(self._port) if self._terminal is None else self._terminal.link()
        self._links.append(link)
        return link

    def fly(self, kind, *others, **options):
        """Create and connect a vehicle; ``others`` are served while it waits."""
        vehicle = kind(self.link(), **options)
        vehicle.others = others
        self._vehicles.append(vehicle)
        vehicle.connect()
        return vehicle

    def complaints(self):
        """The agent's warnings since the last :meth:`land`."""
        return [line for line in self.agent.lines[self._looked_at :] if "warning" in line]

    def land(self):
        """Close the sessions of all vehicles and their links, for the next test."""
        for vehicle in self._vehicles:
            vehicle.land()
        self._vehicles.clear()
        for link in self._links:
            link.close()
        self._links.clear()
        self._looked_at = len(self.agent.lines)

    def __enter__(self):
        return self

    def __exit__(self, *about):
        self.agent.__exit__(*about)
        for link in self._links:
            link.close()
        if self._terminal is not None:
            self._terminal.close()


# --- the DDS side ----------------------------------------------------------------------------


class Places:
    """One place for each transport, created at its first use."""

    def __init__(self, domain, *arguments):
        self._arguments = domain, *arguments
        self._places = {}

    def __getitem__(self, transport):
        if transport not in self._places:
            self._places[transport] = Place(transport, *self._arguments)
        return self._places[transport]

    def __enter__(self):
        return self

    def __exit__(self, *about):
        for place in self._places.values():
            place.__exit__(*about)


class Ground:
    """A ROS node without message types: it publishes and takes plain CDR, and has the graph."""

    def __init__(self, domain):
        from uros.host.network import Network

        self.domain = domain
        self._network = Network(domain)
        self._middleware = self._network._middleware  # to wait for it together with a link
        self.node = self._network.node
        self.graph = self._network.graph
        self._endpoints = []
        self.forget()

    def forget(self):
        """Close all endpoints and drop their samples."""
        for endpoint in self._endpoints:
            endpoint.close()
        self._endpoints.clear()
        self.samples = defaultdict(list)  # DDS topic → samples, as plain CDR
        self.count = 0

    def wait_for_empty_graph(self):
        """Wait until the graph has no node and topic of vehicles any more."""
        self.forget()
        graph = self.graph

        def entries():
            return len(graph.nodes()), graph.topics()

        until(lambda: entries() == (1, {}), self, what=lambda: f"still there: {entries()}")

    def fileno(self):
        return self._middleware.fileno()

    def ready(self):
        self._middleware.dispatch()

    def tick(self):
        self._middleware.dispatch_local()
        due = self._middleware.next_deadline()
        if due is None:
            return None
        self._middleware.tick()
        return max(0.0, due - time.monotonic())

    def listen(self, topic, type_name, qos):
        def on_ready():
            while taken := reader.take(64):
                self.samples[topic].extend(sample[4:] for sample in taken)
                self.count += len(taken)

        reader = self.node.create_reader(topic, type_name, qos, on_ready)
        self._endpoints.append(reader)

    def writer(self, topic, type_name, qos):
        """A function that writes a sample of plain CDR."""
        writer = self.node.create_writer(topic, type_name, qos)
        self._endpoints.append(writer)
        return lambda sample: writer.write(b"\0\1\0\0" + sample)

    def caller(self, service):
        """``(call, replies)``: ``call(request)`` sends, ``replies`` gets ``(number, reply)``."""
        from uros.qos import services_profile

        replies = []

        def on_ready():
            while taken := requester.take(16):
                replies.extend((number, reply[4:]) for number, reply in taken)

        requester = self.node.create_requester(service, services_profile(), on_ready)
        self._endpoints.append(requester)
        return lambda request: requester.request(b"\0\1\0\0" + request), replies

    def close(self):
        self._network.close()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()
