"""A real agent, boards and nodes for tests of `uros doctor`, and its findings."""

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
from support.middleware import WITH_SERVICES
from uros.qos import QoSProfile, ReliabilityPolicy
from uros.tools.doctor.finding import PROBLEM, Finding
from uros.transport.udp import UdpTransport


def spare_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        return sock.getsockname()[1]


@contextmanager
def agent(port, *options):
    """A process of `uros agent`, which listens when the block begins."""
    process = subprocess.Popen(
        [sys.executable, "-m", "uros", "agent", "udp4", "-m", WITH_SERVICES, "--port", str(port),
         *options],
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
    """Spin a node in a thread of its own until the end of the block."""
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
    """A board that publishes /temp, stamped with a clock that is off by ``clock`` seconds.

    ``qos`` may have ``reliability: best_effort``.
    """
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


def run_doctor(agent, domain, port, *options):
    """Run `uros doctor`; (the problems, all findings)."""
    done = subprocess.run(
        [sys.executable, "-m", "uros", "doctor", "--json", "--domain", str(domain), "--port",
         str(port), "--agent", str(agent.pid), "--seconds", "0.6", *options],
        capture_output=True, text=True, timeout=45,
    )  # fmt: skip
    assert done.stdout, done.stderr
    report = json.loads(done.stdout)
    assert report["version"] == 1
    findings = [Finding(**fields) for fields in report["findings"]]
    problems = [finding for finding in findings if finding.state == PROBLEM]
    assert report["problems"] == len(problems)
    assert done.returncode == bool(problems)
    assert "..." in done.stderr  # it prints its progress while it listens
    return problems, findings


def one_of(findings, check):
    """The only finding of a check."""
    (match,) = [finding for finding in findings if finding.check == check]
    return match
