"""Choosing a middleware by name."""

import subprocess
import sys

import pytest

from uros.middleware import NAMES, cyclone_package, open_middleware
from uros.middleware.base import MiddlewareError

CYCLONES = {"auto", "dds"}


@pytest.mark.parametrize(
    "name",
    [
        *sorted(NAMES.keys() - {"ros2"} - CYCLONES),
        *(pytest.param(name, marks=pytest.mark.cyclone) for name in sorted(CYCLONES)),
    ],
)
def test_every_name_opens_a_middleware_that_knows_its_name(name):
    middleware = open_middleware(name)
    assert middleware.name == name
    middleware.close()


def test_an_unknown_name_is_refused_with_the_list_of_names():
    message = "no middleware 'dss'; there are: auto, ced, dds, memory, ros2"
    with pytest.raises(ValueError, match=message):
        open_middleware("dss")


@pytest.fixture
def no_cyclone(monkeypatch):
    for name in [name for name in sys.modules if name.startswith("uros.middleware.dds")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "cyclonedds", None)


@pytest.mark.parametrize(
    ("has_wheel", "words"),
    [(True, r"python -m pip install 'cyclonedds.*or use -m rtps"), (False, "PyPI has no wheel")],
)
def test_without_cyclone_the_error_of_dds_says_what_to_do(
    no_cyclone, monkeypatch, has_wheel, words
):
    monkeypatch.setattr(cyclone_package, "has_wheel", lambda: has_wheel)
    with pytest.raises(MiddlewareError, match="needs cyclonedds: " + words) as caught:
        open_middleware("dds")
    assert ("pip install" in str(caught.value)) == has_wheel


def test_without_cyclone_auto_is_rtps(no_cyclone):
    middleware = open_middleware("auto")
    assert middleware.name == "rtps"
    middleware.close()


def test_without_rclpy_the_error_says_what_to_source_or_install(monkeypatch):
    for name in [name for name in sys.modules if name.split(".")[0] == "rclpy"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "rclpy", None)
    with pytest.raises(MiddlewareError, match="needs rclpy.*: source /opt/ros/.*pip install ros-"):
        open_middleware("ros2")


def test_rclpy_waits_for_the_first_service():
    program = (
        "import sys\n"
        "from uros.middleware import open_middleware\n"
        "open_middleware('auto').close()\n"
        "print([name for name in sys.modules if 'rclpy' in name or 'ros2' in name])\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.stdout == "[]\n", done.stderr
