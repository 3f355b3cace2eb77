"""Compares service calls of boards by RTPS in Python with calls by rclpy, in one run.

    python bench/services.py [--quick] [--domain N]

A board calls a service of an rclpy node: board → agent → server → agent → board, with a request
and a reply of 64 bytes, best effort between board and agent. One agent has ``-m rtps``; the
other one has ``-m ros2`` and runs with the Python of .venv-ros. Each calls a service of its own on
the same node, in turn.
"""

from __future__ import annotations

import argparse
import os
import struct
import time
from pathlib import Path

from agent import cores_awake
from load import PARTICIPANT, Board, round_trips
from process import DOMAIN, HERE, PORT, Process

from uros.wire import data, entities, ids, session
from uros.wire.cdr import Reader, Writer

ROS_PYTHON = HERE.parent / ".venv-ros" / "bin" / "python"
MIDDLEWARES = ("ros2", "rtps")
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

    def _create_entities(self, topic: str, reading: bool) -> None:
        def binary(push, *arguments) -> bytes:  # type: ignore[no-untyped-def]
            w = Writer(bytearray(512))
            push(w, *arguments)
            return bytes(w.buf[: w.offset])

        name = self._service
        topics = f"rq{name}Request", f"rr{name}Reply"
        node = binary(entities.push_binary_participant, f"board_{self.key}", None)
        client = binary(entities.push_binary_service, name, *TYPES, *topics)
        wanted = [(PARTICIPANT, node, 0), (REQUESTER, client, PARTICIPANT)]
        for number, (object_id, content, parent) in enumerate(wanted):
            w = self._message(1024)
            w.begin(ids.CREATE, ids.FLAG_LITTLE_ENDIAN | ids.FLAG_REPLACE)
            entities.push_create(w, number + 10, object_id, ids.IN_BINARY, content, parent)
            self.sock.send(w.finish())
        w = self._message(64)
        w.begin(ids.READ_DATA)
        control = (ids.MAX_SAMPLES_UNLIMITED, 0, 0, 0)
        data.push_read_data(w, 40, REQUESTER, ids.STREAM_BEST_EFFORT, control=control)
        self.sock.send(w.finish())
        answers = 0
        while answers < len(wanted):
            message = self._receive(30.0)
            if message[4] == ids.STATUS:
                _, object_id, status, _ = session.pull_status(Reader(message, 8, len(message)))
                if status != ids.STATUS_OK:
                    raise RuntimeError(f"object {object_id:04X}: {ids.status_name(status)}")
                answers += 1
        self._acknack(answers)

    def request(self) -> bytearray:
        """A datagram with a request; bytes 2 and 3 are for its sequence number."""
        head = bytearray((0x81, ids.STREAM_BEST_EFFORT, 0, 0, ids.WRITE_DATA, 1))
        head += struct.pack("<H", len(REQUEST) + 4) + struct.pack(">HH", 50, REQUESTER)
        return head + REQUEST

    def until_answered(self, datagram: bytearray) -> None:
        """Send requests until one is answered, and wait until no more replies come."""
        self.sock.settimeout(0.2)
        end = time.monotonic() + 30
        answered = False
        while not answered:
            if time.monotonic() > end:
                raise TimeoutError(f"{self._service} does not answer")
            self.sock.send(datagram)
            datagram[2] += 1
            answered = self._drain()
        while self._drain():
            pass

    def _drain(self) -> bool:
        try:
            return len(self.sock.recv(65536)) >= len(REQUEST)
        except TimeoutError:
            return False


def agent(middleware: str, port: int, domain: int) -> Process:
    python: dict[str, Path | str] = {"python": ROS_PYTHON} if middleware == "ros2" else {}
    command = ("-m", "uros", "agent", "udp4", "-p", str(port), "-m", middleware)
    return Process(
        *command, "--domain", str(domain), ready="running...",
        PYTHONPATH=str(HERE.parent / "src"), **python,  # type: ignore[arg-type]
    )  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="a tenth of the time, noisy")
    parser.add_argument("--domain", type=int, default=DOMAIN)
    options = parser.parse_args()
    if not ROS_PYTHON.exists():
        raise SystemExit("there is no .venv-ros: run python3 scripts/env.py ros")
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    count, runs = (100, 3) if options.quick else (500, 9)
    services = {name: f"/bench/{name}" for name in MIDDLEWARES}
    processes = [
        Process(
            "service_server.py", str(options.domain), *services.values(),
            ready="ready", python=ROS_PYTHON,
        )
    ]  # fmt: skip
    figures: dict[str, list[tuple[float, float]]] = {name: [] for name in MIDDLEWARES}
    boards: dict[str, tuple[CallingBoard, bytearray]] = {}
    agents: dict[str, Process] = {}
    try:
        for number, name in enumerate(MIDDLEWARES):
            agents[name] = agent(name, PORT + number, options.domain)
            processes.append(agents[name])
            board = CallingBoard(PORT + number, 0x1000 + number, services[name])
            boards[name] = board, board.request()
            board.until_answered(boards[name][1])
        with cores_awake():
            for run in range(-1, runs):  # the first one warms up
                for name, (board, datagram) in boards.items():
                    times = round_trips(board.sock, datagram, 2, count)
                    if run >= 0:
                        figures[name].append((times[count // 2], times[count * 99 // 100]))
        memory = {name: process.resident() for name, process in agents.items()}
    finally:
        for process in processes:
            process.close()
    print(f"  {'':<42}{'ros2':>12}{'rtps':>12}  ratio     goal")
    for index, what in enumerate(("p50", "p99")):
        ros2, rtps = (
            sorted(run[index] for run in figures[name])[runs // 2] for name in MIDDLEWARES
        )
        goal = f"≤ {GOAL} ×" if what == "p50" else ""
        print(f"  {'service call ' + what + ', µs':<42}{ros2:12.1f}{rtps:12.1f}  "
              f"{rtps / ros2:6.2f} ×  {goal}")  # fmt: skip
    print(f"  {'memory of the agent, MB':<42}{memory['ros2']:12.1f}{memory['rtps']:12.1f}  "
          f"{memory['rtps'] / memory['ros2']:6.2f} ×  < 40 MB")  # fmt: skip


if __name__ == "__main__":
    main()
