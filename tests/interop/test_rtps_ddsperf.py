"""RTPS in Python and ddsperf, a program of Debian's Cyclone DDS 0.10.

ddsperf's topic of plain numbers has no key, as topics of ROS. Its endpoints are volatile.
"""

import re
import select
import shutil
import subprocess

import pytest
from interop.test_rtps_qos import DataPlane

from uros.qos import QoSProfile, ReliabilityPolicy

pytestmark = pytest.mark.timeout(120)

TYPE = "OneULong"
COUNT = 200
KINDS = {
    "reliable": ("DDSPerfRDataOU", ReliabilityPolicy.RELIABLE, []),
    "best-effort": ("DDSPerfUDataOU", ReliabilityPolicy.BEST_EFFORT, ["-u"]),
}


@pytest.fixture
def plane(domain):
    made = DataPlane(domain)
    yield made
    made.close()


@pytest.fixture
def ddsperf(domain):
    """Starts ddsperf with arguments."""
    if shutil.which("ddsperf") is None:
        pytest.fail("there is no ddsperf: apt-get install cyclonedds-tools")
    running = []

    def start(*arguments):
        process = subprocess.Popen(
            ["ddsperf", "-i", str(domain), "-T", "OU", *arguments], stdout=subprocess.PIPE
        )
        running.append(process)
        return process

    yield start
    for process in running:
        process.kill()
        process.wait()
        process.stdout.close()


def number_of(sample):
    return int.from_bytes(sample[4:8], "little")


@pytest.mark.parametrize("kind", KINDS)
def test_what_ddsperf_publishes_arrives(plane, ddsperf, kind):
    topic, reliability, options = KINDS[kind]
    numbers = []

    def take():
        numbers.extend(map(number_of, reader.take(1000)))

    with plane.lock:
        qos = QoSProfile(reliability=reliability, depth=1000)
        reader = plane.node.create_reader(topic, TYPE, qos, take)
    ddsperf(*options, "pub", "500Hz")
    plane.until(lambda: len(numbers) >= COUNT, 30)
    if kind == "reliable":
        assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
    else:
        assert numbers == sorted(set(numbers))


@pytest.mark.parametrize("kind", KINDS)
def test_ddsperf_receives_what_is_written(plane, ddsperf, kind):
    topic, reliability, options = KINDS[kind]
    with plane.lock:
        qos = QoSProfile(reliability=reliability, depth=1000)
        writer = plane.node.create_writer(topic, TYPE, qos)
    process = ddsperf(*options, "-1", "sub")
    plane.until(writer.matched, 30)
    total = written = 0
    while total < COUNT:
        with plane.lock:
            for number in range(written, written + 50):
                assert writer.write(b"\0\1\0\0" + number.to_bytes(4, "little"))
        written += 50
        report = None
        while report is None:  # it writes a line for each sample, too
            assert select.select([process.stdout], [], [], 30)[0], "ddsperf reports nothing"
            report = re.search(rb"total (\d+) lost (\d+)", process.stdout.readline())
        total, lost = map(int, report.groups())
        assert total + lost <= written
        if kind == "reliable":
            assert lost == 0
