"""Paths to numbers of messages."""

import pytest

from uros.interfaces import load
from uros.tools.errors import ToolError
from uros.tools.plot.field import getter, numbers

IMU = load("sensor_msgs/msg/Imu")


@pytest.mark.parametrize("path", ["linear_acceleration/x", "linear_acceleration.x"])
def test_a_nested_field(path):
    message = IMU()
    message.linear_acceleration.x = 9.81
    assert getter(IMU, path)(message) == 9.81


def test_an_element_of_an_array_and_of_a_sequence():
    message = IMU()
    message.orientation_covariance[4] = 0.5
    assert getter(IMU, "orientation_covariance[4]")(message) == 0.5
    battery = load("sensor_msgs/msg/BatteryState")
    get = getter(battery, "cell_voltage[1]")
    assert get(battery(cell_voltage=[3.5, 4.0])) == 4.0
    assert get(battery(cell_voltage=[3.5])) is None  # a gap


def test_booleans_and_bytes_are_numbers():
    assert getter(load("std_msgs/msg/Bool"), "data")(load("std_msgs/msg/Bool")(data=True)) == 1.0
    assert getter(load("std_msgs/msg/Byte"), "data")(load("std_msgs/msg/Byte")(data=7)) == 7.0


@pytest.mark.parametrize(
    "type_name, path, said",
    [
        ("sensor_msgs/Imu", "linear_accel/x", "no field 'linear_accel'; did you mean 'linear_acc"),
        ("sensor_msgs/Imu", "linear_acceleration/w", "linear_acceleration has no field 'w'; num"),
        ("sensor_msgs/Imu", "linear_acceleration", "is no number; numbers of sensor_msgs/msg/Imu:"),
        ("sensor_msgs/Imu", "header/frame_id", "header/frame_id is no number"),
        ("sensor_msgs/Imu", "orientation_covariance", "name one of its numbers, such as orient"),
        ("sensor_msgs/Imu", "header/stamp/sec[0]", "has one index too many"),
        ("sensor_msgs/Imu", "header/stamp/sec/x", "sec has no field 'x'"),
        ("sensor_msgs/Imu", "a[b]", "no field 'a[b]'"),
        ("std_msgs/String", "data", "std_msgs/msg/String has no numbers"),
    ],
)
def test_paths_to_no_number(type_name, path, said):
    with pytest.raises(ToolError) as error:
        getter(load(type_name), path)
    assert said in str(error.value)


def test_the_numbers_of_a_message():
    assert list(numbers(load("sensor_msgs/msg/BatteryState")))[:3] == [
        "header/stamp/sec", "header/stamp/nanosec", "voltage",
    ]  # fmt: skip
    assert "cell_voltage[0]" in numbers(load("sensor_msgs/msg/BatteryState"))
