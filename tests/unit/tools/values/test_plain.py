import pytest
from hypothesis import given
from hypothesis import strategies as st

from uros.interfaces import load
from uros.interfaces.codec import from_cdr, to_cdr
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


# --- paths ------------------------------------------------------------------------


@pytest.mark.parametrize(
    "text, steps",
    [
        ("a", ["a"]),
        ("a.b_2", ["a", "b_2"]),
        (".a..b.", ["a", "b"]),
        ("a[0].b[-1]", ["a", 0, "b", -1]),
        ("a[1:3]", ["a", slice(1, 3)]),
        ("a[::2][:]", ["a", slice(None, None, 2), slice(None, None)]),
    ],
)
def test_paths(text, steps):
    assert values.parse_path(text) == steps
    assert values.parse_path(values.path_text(steps)) == steps


@pytest.mark.parametrize(
    "text", ["", ".", "a[]", "a[x]", "a[1:2:3:4]", "a[--1]", "a[0", "[0]", "a b", "1a", "a[::0]"]
)
def test_what_is_no_path(text):
    with pytest.raises(ValueError):
        values.parse_path(text)


@given(st.text("ab_.[]:-019 \u0663", max_size=30))
def test_any_text_is_a_path_or_a_value_error(text):
    try:
        steps = values.parse_path(text)
    except ValueError:
        return
    assert values.parse_path(values.path_text(steps)) == steps


def test_elements_and_slices():
    pose = load("geometry_msgs/msg/Pose")
    message = load("geometry_msgs/msg/PoseArray")(poses=[pose(), pose()])
    message.poses[1].position.x = 2.5

    def selected(text):
        return values.text(*values.select(message, values.parse_path(text)))

    assert selected("poses[1].position.x") == "2.5"
    assert selected("poses[:].position.x") == "array('d', [0.0, 2.5])"
    assert selected("poses[5:].position") == "[]"
    stamp, kind = values.select(message, ["poses", 0, "position"])
    assert kind == "" and stamp._TYPE == "geometry_msgs/msg/Point"
    for text, said in (
        ("poses[2]", "poses has 2 elements, and so no [2]"),
        ("header[0]", "header is a std_msgs/Header, which has no elements"),
        ("poses[0][0]", "poses[0] is a geometry_msgs/Pose, which has no elements"),
        ("poses.position", "poses is a sequence<geometry_msgs/Pose>, which has no fields"),
        ("poses[:].x", "geometry_msgs/msg/Pose has no field 'x'"),
        ("header.frame_id[0:1]", "header.frame_id is a string, which has no elements"),
    ):
        with pytest.raises(values.FieldError) as caught:
            selected(text)
        assert said in str(caught.value)


def test_constructed():
    assert (
        values.constructed(load("std_srvs/Trigger").Request()) == "std_srvs.srv.Trigger_Request()"
    )
    pose = load("geometry_msgs/Point")(x=1.0)
    assert values.constructed(pose) == "geometry_msgs.msg.Point(x=1.0, y=0.0, z=0.0)"
    kind = load("std_msgs/ByteMultiArray")
    data = from_cdr(kind, to_cdr(kind(data=[1])))
    assert values.constructed(data).endswith("data=[b'\\x01'])")


def test_a_field_that_is_an_array_of_messages():
    arrays = load("test_msgs/msg/Arrays")()
    text = values.text(*values.select(arrays, ["basic_types_values"]))
    assert text.startswith("[test_msgs.msg.BasicTypes(bool_value=False, byte_value=b'\\x00', ")
