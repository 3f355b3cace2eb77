"""The test's end of tests/interop/peer.py: a real rclpy node in a process of its own."""

import collections
import json
import os
import queue
import subprocess
import threading
import time
from pathlib import Path

SCRIPT = Path(__file__).parent.parent / "interop" / "peer.py"
START_SECONDS = 30.0


def ros_distro(python):
    """The ROS 2 distribution of an interpreter with rclpy from PyPI, such as ``kilted``."""
    packages = Path(python).parent.parent.glob("lib/python3*/site-packages/ros_*_rclpy-*.dist-info")
    (name,) = {path.name.split("_")[1] for path in packages}
    return name


class RosPeer:
    """The process; a context manager.

    ``messages`` has CDR samples by topic, ``times`` their arrival by rclpy's clock, in ns, and
    ``events`` what rclpy said of the QoS of subscriptions; ``distro`` is that of ROS 2.
    """

    def __init__(self, python, domain, script=SCRIPT):
        environment = dict(os.environ, ROS_DOMAIN_ID=str(domain), PYTHONWARNINGS="default")
        for name in ("CYCLONEDDS_URI", "PYTHONPATH", "RMW_IMPLEMENTATION"):
            environment.pop(name, None)
        self._process = subprocess.Popen(
            [str(python), str(script)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=environment,
        )
        self._lines = queue.Queue()
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()
        self._number = 0
        self.distro = ros_distro(python)
        self.messages = collections.defaultdict(collections.deque)
        self.times = collections.defaultdict(collections.deque)
        self.events = collections.defaultdict(list)

    def _read(self):
        for line in self._process.stdout:
            if line.startswith("{"):
                self._lines.put(json.loads(line))
        self._lines.put(None)

    def _next(self, deadline, what):
        try:
            event = self._lines.get(timeout=max(0.0, deadline - time.monotonic()))
        except queue.Empty:
            raise AssertionError(f"the peer does not say {what}") from None
        assert event is not None, f"the peer has ended (status {self._process.wait()})"
        if event.get("event") == "message":
            self.messages[event["topic"]].append(bytes.fromhex(event["cdr"]))
            self.times[event["topic"]].append(event["now"])
        elif "event" in event and "topic" in event:
            self.events[event.pop("topic")].append(event)
        return event

    def __enter__(self):
        deadline = time.monotonic() + START_SECONDS
        while self._next(deadline, "that it is ready").get("event") != "ready":
            pass
        return self

    def __exit__(self, *_):
        self._process.stdin.close()
        try:
            self._process.wait(START_SECONDS)
        finally:
            self._process.kill()
            self._thread.join()
            self._process.stdout.close()

    def do(self, verb, seconds=15.0, **arguments):
        """Run a command in the peer, for at most ``seconds``; its answer."""
        self._number += 1
        command = {"id": self._number, "do": verb, **arguments}
        if verb not in ("graph", "unsubscribe"):
            command["seconds"] = seconds
        self._process.stdin.write(json.dumps(command) + "\n")
        self._process.stdin.flush()
        deadline = time.monotonic() + seconds + 5
        while True:
            event = self._next(deadline, f"what came of {verb}")
            if event.get("id") == self._number:
                assert "error" not in event, event
                return event

    def message(self, topic, seconds=15.0):
        """The next message of a subscribed topic."""
        return self.timed_message(topic, seconds)[0]

    def timed_message(self, topic, seconds=15.0):
        """The next message of a subscribed topic, and when it arrived."""
        deadline = time.monotonic() + seconds
        while not self.messages[topic]:
            self._next(deadline, f"that anything came on {topic}")
        return self.messages[topic].popleft(), self.times[topic].popleft()

    def event(self, topic, seconds=15.0):
        """The next event of a subscription's QoS."""
        deadline = time.monotonic() + seconds
        while not self.events[topic]:
            self._next(deadline, f"anything of the QoS of {topic}")
        return self.events[topic].pop(0)

    def listen(self, seconds):
        """Receive what comes within this time."""
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            try:
                self._next(deadline, "anything")
            except AssertionError:
                assert self._process.poll() is None
                return
