"""Which messages a program makes without arguments."""

import ast

import pytest

from uros.boards.bare import bare
from uros.boards.shrink import Module

IMU = "sensor_msgs/msg/Imu"
TIME = "builtin_interfaces/msg/Time"
IMPORTS = "from sensor_msgs.msg import Imu\nfrom builtin_interfaces.msg import Time as Stamp\n"


def found(*texts):
    modules = [
        Module(f"m{number}", False, "", text, ast.parse(text), True)
        for number, text in enumerate(texts)
    ]
    return bare(modules, [IMU, TIME])


@pytest.mark.parametrize("text", [
    "",
    "imu = Imu()",
    "publisher = node.create_publisher(Imu, 'imu', 10)",
    "node.create_subscription(msg_type=Imu, topic='imu', callback=print, qos_profile=10)",
    "def on_imu(message: Imu) -> Imu: return message",
    "last: Imu | None = None",
    "print(isinstance(last, Imu))",
])  # fmt: skip
def test_made_without_arguments(text):
    assert found(IMPORTS + text) == {IMU, TIME}


@pytest.mark.parametrize("text", [
    "imu = Imu(header=header)",
    "imu = Imu(*parts)",
    "imu = Imu(**parts)",
    "make = Imu",
    "made = [make(1) for make in (Imu,)]",
    "register(Imu)",
    "class Mine(Imu): pass",
    "Imu = partial(Imu, header)",
    "import sensor_msgs.msg\nimu = sensor_msgs.msg.Imu(header)",
    "print(isinstance(last, (Imu, int)))",
])  # fmt: skip
def test_perhaps_made_with_arguments(text):
    assert found(IMPORTS + text) == {TIME}


@pytest.mark.parametrize("text", [
    "publisher.publish(publisher.type(header))",
    "copy = type(message)(header=header)",
    "copy = message.__class__(header)",
])  # fmt: skip
def test_made_by_a_class_without_a_name(text):
    assert found(IMPORTS + text) == set()
    assert found(IMPORTS + "print(type(message), publisher.type(), type(message)())") == {IMU, TIME}


def test_one_module_with_arguments_is_enough():
    assert found(IMPORTS, IMPORTS + "Stamp(sec=1)") == {IMU}


def test_a_type_that_another_module_passes_on():
    assert found(IMPORTS, "from m0 import Imu\nImu(1)") == {TIME}
    assert found(IMPORTS, "from m0 import Stamp\nStamp(1)") == {IMU}
    assert found(IMPORTS, "import m0\nm0.Stamp(1)") == {IMU}
