"""A real agent, boards and nodes for `uros doctor` to look at, and what it finds."""

import json
import socket
import subprocess
import sys
import threading
import time
from contextlib import contextmanager

from uros.interfaces.sensor_msgs.msg import Temperature

import uros
from support.lines import SECONDS
from uros.qos import QoSProfile, ReliabilityPolicy
from uros.tools.doctor.finding import PROBLEM, Finding
from uros.transport.udp import UdpTransport


def spare_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        return sock.getsockname()[1]


@contextmanager
def agent(port, *options):
    """`uros agent`, listening when the block begins."""
    process = subprocess.Popen(
        [sys.executable, "-m", "uros", "agent", "udp4", "--port", str(port), *options],
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
    )  # fmt: skip
    reader = threading.Thread(target=process.stdout.read)
    try:
        for line in process.stdout:
            if "running" in line:
                break
        reader.start()
        yield process
    finally:
        process.terminate()
        process.wait(SECONDS)
        reader.join()
        process.stdout.close()


@contextmanager
def spinning(make):
    """A node in a thread that is its own, until the end of the block."""
    end, ready, failed = threading.Event(), threading.Event(), []

    def run():
        try:
            node, is_ready = make()
            deadline = time.monotonic() + SECONDS
            while not end.is_set():
                node.spin_once(0.02)
                if is_ready():
                    ready.set()
                elif time.monotonic() > deadline:
                    assert ready.is_set(), "the board finds no agent"
            node.destroy_node()
        except BaseException as error:
            failed.append(error)
            ready.set()

    thread = threading.Thread(target=run)
    thread.start()
    try:
        assert ready.wait(SECONDS)
        yield
    finally:
        end.set()
        thread.join()
    assert not failed, failed


def board(port, domain, qos=None, key=0x0D0C0001, clock=0.0, name="board"):
    """A board that publishes /temp, stamped by a clock that is so far off.

    ``qos`` may say ``reliability: best_effort``."""
    profile = QoSProfile()
    if qos:
        assert qos == {"reliability": "best_effort"}
        profile.reliability = ReliabilityPolicy.BEST_EFFORT

    def make():
        node = uros.Node(name, UdpTransport("127.0.0.1", port), key=key, domain_id=domain)
        publisher = node.create_publisher(Temperature, "/temp", profile)
        message = Temperature()

        def publish():
            now = time.time() + clock
            message.header.stamp.sec = int(now)
            message.header.stamp.nanosec = int(now % 1 * 1e9)
            publisher.publish(message)

        node.create_timer(0.02, publish)
        return node, lambda: publisher.published > 0

    return spinning(make)


def listener(domain, type=Temperature, topic="/temp"):
    def make():
        node = uros.Node("listener", domain_id=domain)
        node.create_subscription(type, topic, lambda message: None, 10)
        quiet = node.connection.middleware.next_deadline
        return node, lambda: quiet() is None

    return spinning(make)


def look(which, domain, port, *options):
    """What the doctor finds, as he says it."""
    done = subprocess.run(
        [sys.executable, "-m", "uros", "doctor", "--json", "--domain", str(domain), "--port",
         str(port), "--agent", str(which.pid), "--seconds", "0.6", *options],
        capture_output=True, text=True, timeout=45,
    )  # fmt: skip
    assert done.stdout, done.stderr
    told = json.loads(done.stdout)
    assert told["version"] == 1
    found = [Finding(**it) for it in told["findings"]]
    problems = [it for it in found if it.state == PROBLEM]
    assert told["problems"] == len(problems)
    assert done.returncode == bool(problems)
    assert "..." in done.stderr  # it says what it is about while it listens
    return problems, found


def one_of(found, check):
    (one,) = [it for it in found if it.check == check]
    return one
