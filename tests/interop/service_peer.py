"""peer.py with services: a real rclpy node as service client and server for boards."""

import time

import rclpy
from peer import Peer, find_type
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message, serialize_message

ASK_AGAIN = 3.0


class ServicePeer(Peer):
    def __init__(self):
        super().__init__()
        self.clients = {}
        self.servers = {}
        self.counted = {}  # the requests that each service of do_count has received
        self.answered = set()  # services that have answered
        self.added = {}  # the first summand of each request to a service of do_add

    def do_serve(self, name, type, late=0.0, text="answer {}", first=1, seconds=15):
        """Serve a Trigger that answers with a rising number, each time after ``late`` seconds.

        With ``first=0``, every second response has ``success=False``, as that of
        ``uros run trigger_service``.
        """
        count = first - 1

        def answer(_request, response):
            nonlocal count
            count += 1
            time.sleep(late)
            response.success, response.message = bool(first) or count % 2 == 0, text.format(count)
            return response

        self.servers[name] = self.node.create_service(find_type(type), name, answer)
        return {}

    def do_serve_no_more(self, name, seconds=15):
        self.node.destroy_service(self.servers.pop(name))
        return {}

    def do_count(self, name, type, seconds=15):
        """Serve with a callback that only records each request."""
        cls = find_type(type)
        self.counted[name] = []

        def answer(request, response):
            self.counted[name].append(str(request))
            return response

        self.servers[name] = self.node.create_service(cls, name, answer)
        return {}

    def do_counted(self, name, least=0, seconds=15):
        """Return the requests that do_count recorded, as soon as there are ``least`` of them
        (at least one) or the time is up."""
        self.wait(seconds, lambda: len(self.counted[name]) >= max(1, least))
        return {"requests": self.counted[name]}

    def do_add(self, name, type, depth=10, seconds=15):
        """Serve a BasicTypes whose response has the sum of two numbers, and the request's text."""
        added = self.added[name] = []

        def add(request, response):
            added.append(request.int64_value)
            response.int64_value = request.int64_value + request.int32_value
            response.string_value = request.string_value
            return response

        self.servers[name] = self.node.create_service(
            find_type(type), name, add, qos_profile=QoSProfile(depth=depth)
        )
        return {}

    def do_added(self, name, seconds=15):
        """Return the first summands of all requests so far, and forget them."""
        added = list(self.added[name])
        self.added[name].clear()
        return {"added": added}

    def do_call_at_once(self, name, type, cdr, depth=10, seconds=15):
        """Send requests, given as CDR, without waiting in between; return the responses in the
        order of the requests, None for those that have not come. An answer must have come before.
        """
        cls = find_type(type)
        if (name, depth) not in self.clients:
            self.clients[name, depth] = self.node.create_client(
                cls, name, qos_profile=QoSProfile(depth=depth)
            )
        client = self.clients[name, depth]
        if not self.wait(seconds, client.service_is_ready):
            return {"replies": None}
        requests = [deserialize_message(bytes.fromhex(one), cls.Request) for one in cdr]
        futures = [client.call_async(request) for request in requests]
        self.wait(seconds, lambda: all(future.done() for future in futures))
        return {
            "replies": [
                bytes(serialize_message(future.result())).hex() if future.done() else None
                for future in futures
            ]
        }

    def do_call(self, name, type, cdr, times=1, seconds=15):
        """Wait for a service, call it ``times`` times; return replies and their round trip times.

        The first request is repeated: a client that has discovered a service may itself not be
        discovered by the service yet, and rmw_fastrtps waits only a tenth of a second for that.
        """
        cls = find_type(type)
        if name not in self.clients:
            self.clients[name] = self.node.create_client(cls, name)
        client = self.clients[name]
        if not self.wait(seconds, client.service_is_ready):
            return {"replies": None}
        request = deserialize_message(bytes.fromhex(cdr), cls.Request)
        replies, took = [], []
        deadline = time.monotonic() + seconds
        for _ in range(times):
            started = time.monotonic()
            future = client.call_async(request)
            while not future.done() and time.monotonic() < deadline:
                self.executor.spin_once(timeout_sec=0.1)
                if name not in self.answered and time.monotonic() - started > ASK_AGAIN:
                    started, future = time.monotonic(), client.call_async(request)
            if not future.done():
                break
            self.answered.add(name)
            took.append(time.monotonic() - started)
            replies.append(bytes(serialize_message(future.result())).hex())
        return {"replies": replies, "took": took}

    def do_services(self, namespace, name, services, clients, seconds=15):
        """Wait until a node has exactly these services and clients (name → types); return those
        that it has."""
        node = self.node

        def look():
            try:
                return (
                    dict(node.get_service_names_and_types_by_node(name, namespace)),
                    dict(node.get_client_names_and_types_by_node(name, namespace)),
                )
            except rclpy.node.NodeNameNonExistentError:
                return None

        self.wait(seconds, lambda: look() == (services, clients))
        return {"found": look(), **self.do_graph()}

    def do_no_service(self, name, seconds=15):
        """Wait until the service has neither a server nor a client, apart from this peer's."""
        node = self.node

        def unused():
            return not (
                node.count_services(name) or node.count_clients(name) - (name in self.clients)
            )

        return {"unused": bool(self.wait(seconds, unused))}


if __name__ == "__main__":
    rclpy.init()
    try:
        ServicePeer().run()
    finally:
        rclpy.shutdown()
