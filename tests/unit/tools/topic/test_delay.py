import pytest

from uros.host.network import Received
from uros.interfaces import load
from uros.interfaces.codec import to_cdr
from uros.tools.errors import ToolError
from uros.tools.topic import delay
from uros.tools.topic.delay import Delays, report

S = 1_000_000_000


def fed(*milliseconds, window=10000):
    delays = Delays(window)
    for each in milliseconds:
        delays.add(each * 1_000_000)
    return delays


def test_the_output_is_that_of_ros2():
    delays = Delays(10)
    assert report(delays) == ""
    delays = fed(100, 300)
    assert report(delays) == (
        "average delay: 0.200\n\tmin: 0.100s max: 0.300s std dev: 0.10000s window: 2\n"
    )
    assert report(delays) == "no new messages\n"
    delays.reset()
    assert report(delays) == ""


def test_the_window():
    assert "min: 0.002s max: 0.003s" in report(fed(1, 2, 3, window=2))


def stamped(type_name, **fields):
    message = load(type_name)(**fields)
    message.header.stamp.sec, message.header.stamp.nanosec = 5, 500_000_000
    return message


@pytest.mark.parametrize(
    "message",
    [
        stamped("sensor_msgs/msg/CompressedImage", format="jpeg", data=b"x"),
        stamped("diagnostic_msgs/msg/DiagnosticArray"),
    ],
)
def test_the_stamp_of_the_header_counts(message):
    delays = Delays(10)
    count = delay._counting(delays, message._TYPE)
    count(Received(to_cdr(message), 0, 0), 6 * S)
    assert list(delays.window) == [S // 2]


def test_a_header_need_not_come_first(tmp_path, monkeypatch):
    folder = tmp_path / "delay_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / "Late.msg").write_text("uint8 level\nstd_msgs/Header header\n")
    monkeypatch.setenv("UROS_INTERFACES", str(tmp_path))
    delays = Delays(10)
    count = delay._counting(delays, "delay_msgs/msg/Late")
    count(Received(to_cdr(stamped("delay_msgs/msg/Late")), 0, 0), 7 * S)
    assert list(delays.window) == [3 * S // 2]


def test_messages_without_a_header_are_refused():
    with pytest.raises(ToolError, match=r"std_msgs/msg/String has no header.*its fields: data"):
        delay._counting(Delays(10), "std_msgs/msg/String")


def test_a_broken_message_is_told_once(capsys):
    count = delay._counting(Delays(10), "sensor_msgs/msg/Imu")
    for _ in range(9):
        count(Received(b"\0\1\0\0", 0, 0), S)
    assert capsys.readouterr().err.count("could not be read") == 1
