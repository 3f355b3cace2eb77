"""Compares service calls of boards by RTPS in Python with calls by rclpy, in one run.

    python bench/services.py [--quick] [--domain N]

A board calls a service of an rclpy node: board → agent → server → agent → board, with a request
and a reply of 64 bytes, best effort between board and agent. One agent has ``-m rtps``; the
other one has ``-m ros2`` and runs with the Python of .venv-ros. Each calls a service of its own on
the same node, in turn.
"""

from __future__ import annotations

import struct

from load import PARTICIPANT, Board, binary, round_trips, until_answered
from process import (
    NO_ROS,
    ROS_PYTHON,
    Process,
    agent,
    cores_awake,
    heading,
    middle,
    options,
    settings,
    show,
)

from uros.wire import entities

COMPARED = ("ros2", "rtps")
REQUESTER = 0x0017
TYPES = "test_msgs::srv::dds_::BasicTypes_Request_", "test_msgs::srv::dds_::BasicTypes_Response_"
# test_msgs/srv/BasicTypes as CDR without encapsulation: 56 bytes of numbers, and a string.
REQUEST = struct.pack("<BBBxfdbBhHxxiIqQI", 1, 2, 3, 4.0, 5.0, 6, 7, 8, 9, 10, 11, 12, 13, 4)
REQUEST += b"abc\0"
GOAL = 0.6


class CallingBoard(Board):
    """A board with one client of a service."""

    def __init__(self, port: int, key: int, service: str) -> None:
        self._service = service
        super().__init__(port, key)

    def _create_entities(self, topic: str, reads: str) -> None:
        name = self._service
        topics = f"rq{name}Request", f"rr{name}Reply"
        node = binary(entities.push_binary_participant, f"board_{self.key}", None)
        client = binary(entities.push_binary_service, name, *TYPES, *topics)
        self._create([(PARTICIPANT, node, 0), (REQUESTER, client, PARTICIPANT)], REQUESTER)

    def request(self) -> bytearray:
        """A datagram with a request; bytes 2 and 3 are for its sequence number."""
        return self.sample(REQUEST, writer=REQUESTER)


def service_server(*services: str) -> Process:
    arguments = (str(settings.domain), *services)
    return Process("service_server.py", *arguments, ready="ready", python=ROS_PYTHON)


def main() -> None:
    quick = options(__doc__, "a tenth of the time, noisy").quick
    if not ROS_PYTHON.exists():
        raise SystemExit(NO_ROS)
    count, runs = (100, 3) if quick else (500, 9)
    services = {name: f"/bench/{name}" for name in COMPARED}
    processes = [service_server(*services.values())]
    figures: dict[str, list[tuple[float, float]]] = {name: [] for name in COMPARED}
    boards: dict[str, tuple[CallingBoard, bytearray]] = {}
    agents: dict[str, Process] = {}
    try:
        for number, name in enumerate(COMPARED):
            agents[name] = agent(name, number)
            processes.append(agents[name])
            board = CallingBoard(settings.port + number, 0x1000 + number, services[name])
            boards[name] = board, board.request()
            until_answered(board.sock, boards[name][1], 2)
        with cores_awake():
            for run in range(-1, runs):  # the first one warms up
                for name, (board, datagram) in boards.items():
                    times = round_trips(board.sock, datagram, 2, count)
                    if run >= 0:
                        figures[name].append((times[count // 2], times[count * 99 // 100]))
        memory = [agents[name].resident() for name in COMPARED]
    finally:
        for process in processes:
            process.close()
    heading(*COMPARED)
    for index, what in enumerate(("p50", "p99")):
        row = [middle([run[index] for run in figures[name]]) for name in COMPARED]
        show(f"service call {what}, µs", row, f"≤ {GOAL} ×" if what == "p50" else "")
    show("memory of the agent, MB", memory, "< 40 MB")


if __name__ == "__main__":
    main()
