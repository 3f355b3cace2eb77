"""How soon the first call of a service is answered, on ``-m rtps`` and towards rclpy.

    python bench/first_calls.py [--quick] [--domain N]

A client of uros that has just started calls an rclpy server: from the discovery of the server's
two endpoints to the reply. An rclpy client that has just started calls a server of uros, from
``service_is_ready()`` to the reply; the same with a server of rclpy, to compare.
"""

from __future__ import annotations

import os
import select
import threading
import time

from process import NO_ROS, ROS_PYTHON, Process, options
from services import REQUEST, TYPES, service_server

from uros.middleware.base import Service
from uros.middleware.rtps.middleware import RtpsMiddleware
from uros.qos import services_profile

SECONDS = 15.0
PAUSE = 0.05


def service(name: str) -> Service:
    return Service(f"rq{name}Request", TYPES[0], f"rr{name}Reply", TYPES[1])


def turn(middleware: RtpsMiddleware, seconds: float = PAUSE) -> None:
    deadline = middleware.next_deadline()
    if deadline is not None:
        seconds = min(seconds, max(0.0, deadline - time.monotonic()))
    select.select([middleware.fileno()], [], [], seconds)
    middleware.dispatch()
    middleware.tick()


def call_of_ours(domain: int, name: str) -> float:
    """Milliseconds from discovery to the reply."""
    middleware = RtpsMiddleware()
    try:
        node = middleware.create_node(domain, "/", "first")
        wanted = service(name)
        requester = node.create_requester(wanted, services_profile(), lambda: None)
        endpoints = middleware._domains[domain].endpoints
        end = time.monotonic() + SECONDS
        found = 0.0
        while not requester.take(1):
            if time.monotonic() > end:
                raise TimeoutError("no answer")
            topics = [data.topic for data in endpoints().values()]
            if not found and all(
                topics.count(topic) == 2 for topic in (wanted.request_topic, wanted.reply_topic)
            ):
                found = time.monotonic()
                requester.request(b"\0\1\0\0" + REQUEST)
            turn(middleware)
        return (time.monotonic() - found) * 1000
    finally:
        middleware.close()


def calls_of_rclpy(domain: int, name: str, count: int) -> list[float]:
    client = Process(
        "first_client.py", str(domain), name, str(count), ready="ready", python=ROS_PYTHON
    )
    try:
        return [float(client.line()) for _ in range(count)]
    finally:
        client.close()


def calls_to_ours(domain: int, name: str, count: int) -> list[float]:
    middleware = RtpsMiddleware()
    node = middleware.create_node(domain, "/", "first_server")

    def answer() -> None:
        for identity, number, cdr in replier.take(10):
            replier.reply(identity, number, cdr)

    replier = node.create_replier(service(name), services_profile(), answer)
    out: list[float] = []
    thread = threading.Thread(target=lambda: out.extend(calls_of_rclpy(domain, name, count)))
    thread.start()
    while thread.is_alive():
        turn(middleware)
    middleware.close()
    return out


def show(what: str, times: list[float]) -> None:
    times = sorted(times)
    within = sum(took <= 100 for took in times)
    print(f"  {what:<42}median {times[len(times) // 2]:6.1f} ms, most {times[-1]:6.1f} ms,"
          f" {within} of {len(times)} within 100 ms", flush=True)  # fmt: skip


def main() -> None:
    parsed = options(__doc__, "a quarter of the calls")
    if not ROS_PYTHON.exists():
        raise SystemExit(NO_ROS)
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    count, domain = 5 if parsed.quick else 20, parsed.domain
    server = service_server("/bench/rclpy")
    try:
        show("a client of uros, a server of rclpy",
             [call_of_ours(domain, "/bench/rclpy") for _ in range(count)])  # fmt: skip
        show("a client of rclpy, a server of uros", calls_to_ours(domain, "/bench/uros", count))
        show("a client and a server of rclpy", calls_of_rclpy(domain, "/bench/rclpy", count))
    finally:
        server.close()


if __name__ == "__main__":
    main()
