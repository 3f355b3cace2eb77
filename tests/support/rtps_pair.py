"""Two middlewares on loopback, as two processes would be, and their data planes."""

import select
import time

from uros.middleware.rtps.middleware import RtpsMiddleware

SECONDS = 30.0


class Pair:
    """Two middlewares with a node each, and their data planes.

    ``domains`` and ``graphs`` are those of each. ``first`` and ``second`` make the middlewares.
    """

    def __init__(self, domain, second=RtpsMiddleware, first=RtpsMiddleware):
        self.middlewares = [first(), second()]
        self.nodes = [
            middleware.create_node(domain, "/", f"node{number}")
            for number, middleware in enumerate(self.middlewares)
        ]
        self.domains = [middleware._domains[domain] for middleware in self.middlewares]
        self.graphs = [middleware.graph(domain, lambda: None) for middleware in self.middlewares]

    def until(self, done):
        end = time.monotonic() + SECONDS
        while not done():
            assert time.monotonic() < end, "it does not happen"
            deadlines = [middleware.next_deadline() for middleware in self.middlewares]
            pause = min(at for at in deadlines if at is not None) - time.monotonic()
            pause = max(0.0, pause)
            ready = select.select(
                [middleware.fileno() for middleware in self.middlewares], [], [], pause
            )[0]
            for middleware in self.middlewares:
                if middleware.fileno() in ready:
                    middleware.dispatch()
                deadline = middleware.next_deadline()
                if deadline is not None and deadline <= time.monotonic():
                    middleware.tick()

    def close(self):
        for middleware in self.middlewares:
            middleware.close()
