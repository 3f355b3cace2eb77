"""The environment of all tests: DDS on loopback only, and ROS domains of their own.

This module sets the environment when it is imported, before a test can load a DDS; processes that
tests start inherit it.
"""

import atexit
import fcntl
import gc
import os
import shutil
import signal
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from hypothesis import settings
from support import cyclone_tests
from support.examples import SCALE
from support.long_tests import LONG

from uros.middleware.cyclone_package import has_wheel

# No deadline: the duration of an example depends on the machine. --hypothesis-profile chooses
# another profile; tests/support/examples.py scales tests with a number of examples of their own.
for _name, _scale in SCALE.items():
    settings.register_profile(_name, deadline=None, max_examples=int(100 * _scale))
settings.load_profile("daily")

ROOT = Path(__file__).resolve().parent.parent

# People use 20 and below; from 102 on the ports are in the ephemeral range of Linux.
DOMAINS = range(21, 101)

os.environ["CYCLONEDDS_URI"] = (
    "<General>"
    '<Interfaces><NetworkInterface address="127.0.0.1"/></Interfaces>'
    "<AllowMulticast>false</AllowMulticast>"
    "</General>"
    "<Discovery>"
    "<ParticipantIndex>auto</ParticipantIndex>"
    "<MaxAutoParticipantIndex>60</MaxAutoParticipantIndex>"
    '<Peers><Peer Address="127.0.0.1"/></Peers>'
    "</Discovery>"
)
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
for name in ("ROS_LOCALHOST_ONLY", "ROS_STATIC_PEERS", "RMW_IMPLEMENTATION", "ROS_DISTRO"):
    os.environ.pop(name, None)
# The folder of the agents' sockets for `uros agent status`, separate for this run.
os.environ["XDG_RUNTIME_DIR"] = tempfile.mkdtemp(prefix="uros-run-")
atexit.register(shutil.rmtree, os.environ["XDG_RUNTIME_DIR"], ignore_errors=True)
# The folder of builds of virtual boards' programs, which all runs share.
os.environ["XDG_CACHE_HOME"] = str(Path(__file__).resolve().parent.parent / "build" / "cache")


# A shell starts background jobs with SIGINT ignored, and child processes inherit that. A handler is
# not inherited, so with one here SIGINT ends the processes that tests start.
signal.signal(signal.SIGINT, signal.default_int_handler)

HAS_CYCLONE = has_wheel()
UNIT = ROOT / "tests" / "unit"


def pytest_report_header() -> str | None:
    """Say that tests are left out."""
    return None if HAS_CYCLONE else "no wheel of cyclonedds: the tests that need it are left out"


def pytest_ignore_collect(collection_path: Path) -> bool | None:
    """Leave out the files that need cyclonedds where it has no wheel."""
    left_out = {UNIT / path for path in cyclone_tests.FILES}
    return None if HAS_CYCLONE or collection_path not in left_out else True


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mark the tests that `make quick` leaves out, and leave out those that need cyclonedds."""
    long_files = {UNIT / path for path in LONG}
    for item in items:
        if item.path in long_files:
            item.add_marker("long")
    left_out = [] if HAS_CYCLONE else [one for one in items if one.get_closest_marker("cyclone")]
    if left_out:
        config.hook.pytest_deselected(items=left_out)
        items[:] = [item for item in items if item not in set(left_out)]


def pytest_collection_finish() -> None:
    """Leave thousands of collected tests out of all garbage collections."""
    gc.collect()
    gc.freeze()


@contextmanager
def leased_domain() -> Iterator[int]:
    """A ROS domain id that no other test, of this run or another, uses at the same time."""
    folder = Path(tempfile.gettempdir()) / f"uros-test-domains-{os.getuid()}"
    folder.mkdir(exist_ok=True)
    for domain in DOMAINS:
        with open(folder / str(domain), "w") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                continue
            yield domain
            return
    pytest.fail(f"all ROS domains from {DOMAINS[0]} to {DOMAINS[-1]} are in use by tests")


@pytest.fixture(scope="session", autouse=True)
def domain_id() -> Iterator[int]:
    """The domain of this test run, also in ROS_DOMAIN_ID of this process and its children."""
    with leased_domain() as domain:
        os.environ["ROS_DOMAIN_ID"] = str(domain)
        yield domain


@pytest.fixture
def own_domain_id() -> Iterator[int]:
    """A domain for a single test, for tests that check a whole graph."""
    with leased_domain() as domain:
        yield domain


@pytest.fixture(scope="session")
def ros_python() -> Path:
    """The interpreter with the real rclpy, for a separate process.

    UROS_TEST_ROS_PYTHON names that of another ROS 2.
    """
    named = os.environ.get("UROS_TEST_ROS_PYTHON")
    python = Path(named) if named else ROOT / ".venv-ros" / "bin" / "python"
    if not python.exists():
        pytest.fail("there is no .venv-ros: run python3 scripts/env.py ros")
    return python
