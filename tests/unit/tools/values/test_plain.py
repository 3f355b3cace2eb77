import pytest

from uros.interfaces import load
from uros.tools.values import plain as values
from uros.tools.values.plain import Show


def image(size=4):
    message = load("sensor_msgs/CompressedImage")(format="jpeg", data=bytes(range(size)))
    message.header.frame_id = "cam"
    return message


def test_a_message_as_plain_values():
    assert values.plain(image(), Show()) == {
        "header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": "cam"},
        "format": "jpeg",
        "data": [0, 1, 2, 3],
    }


def test_long_arrays_and_strings_are_cut():
    plain = values.plain(image(), Show(truncate=2))
    assert plain["data"] == [0, 1, "..."]
    assert plain["format"] == "jp..."
    assert values.plain(image(200), Show())["data"][-2:] == [127, "..."]
    assert len(values.plain(image(200), Show(truncate=None))["data"]) == 200
    assert values.plain(image(2), Show(truncate=2))["data"] == [0, 1]


def test_arrays_and_strings_left_out():
    plain = values.plain(image(), Show(no_arr=True, no_str=True))
    assert plain["data"] == "<sequence type: uint8, length: 4>"
    assert plain["format"] == "<string length: <4>>"
    imu = values.plain(load("sensor_msgs/Imu")(), Show(no_arr=True))
    assert imu["orientation_covariance"] == "<array type: double[9]>"
    path = values.plain(load("nav_msgs/Path")(), Show(no_arr=True))
    assert path["poses"] == "<sequence type: geometry_msgs/msg/PoseStamped, length: 0>"


@pytest.mark.parametrize(
    "kind, text",
    [
        ("sequence<uint8, 10>", "<sequence type: uint8[10], length: 3>"),
        ("sequence<string<5>, 2>", "<sequence type: string[2], length: 3>"),
        ("string[3]", "<array type: string[3]>"),
    ],
)
def test_descriptions_of_arrays(kind, text):
    assert values.describe_array(kind, 3) == text


def test_a_byte_is_a_character():
    message = load("std_msgs/Byte")(data=3)
    assert values.plain(message, Show()) == {"data": "\x03"}
    assert values.csv(message, Show()) == "b'\\x03'"
    assert values.text(*values.select(message, ["data"])) == "b'\\x03'"
    several = load("std_msgs/ByteMultiArray")(data=b"\1\2")
    assert values.plain(several, Show())["data"] == ["\1", "\2"]
    assert values.text(*values.select(several, ["data"])) == "[b'\\x01', b'\\x02']"


def test_arrays_of_messages():
    transform = load("geometry_msgs/TransformStamped")(child_frame_id="arm")
    message = load("tf2_msgs/TFMessage")(transforms=[transform])
    assert values.plain(message, Show())["transforms"][0]["child_frame_id"] == "arm"
    assert values.csv(message, Show()) == "0,0,,arm,0.0,0.0,0.0,0.0,0.0,0.0,1.0"


def test_csv():
    assert values.csv(image(), Show()) == "0,0,cam,jpeg,0,1,2,3"
    assert values.csv(image(), Show(truncate=3)) == "0,0,cam,jpe...,0,1,2,..."
    assert values.csv(image(), Show(no_arr=True, no_str=True)) == (
        "0,0,<string length: <3>>,<string length: <4>>,<sequence type: uint8, length: 4>"
    )
    assert values.csv(load("std_msgs/Bool")(data=True), Show()) == "True"


def test_fields():
    message = image()
    assert values.text(*values.select(message, ["format"])) == "jpeg"
    assert values.text(*values.select(message, ["header", "stamp", "sec"])) == "0"
    assert values.text(*values.select(message, ["data"])) == "array('B', [0, 1, 2, 3])"
    stamp, kind = values.select(message, ["header", "stamp"])
    assert kind == "" and values.plain(stamp, Show()) == {"sec": 0, "nanosec": 0}
    imu = load("sensor_msgs/Imu")()
    assert values.text(*values.select(imu, ["linear_acceleration_covariance"])) == str([0.0] * 9)


@pytest.mark.parametrize(
    "path, said",
    [
        ("size", "sensor_msgs/msg/CompressedImage has no field 'size'; it has header, format"),
        ("format.x", "format is a string, which has no fields"),
        ("header.stamp.x", "builtin_interfaces/msg/Time has no field 'x'; it has sec, nanosec"),
    ],
)
def test_unknown_fields(path, said):
    with pytest.raises(values.FieldError) as caught:
        values.select(image(), path.split("."))
    assert said in str(caught.value)
