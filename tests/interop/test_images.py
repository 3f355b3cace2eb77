"""``uros image save``, as a process, with images that a real rclpy node publishes."""

import subprocess
import sys

import pytest
from unit.dashboard.test_pictures import JPEG, unpacked

from uros.interfaces import load
from uros.interfaces.codec import to_cdr

SECONDS = 30
RAMP = bytes(range(240)) * 240
CompressedImage = load("sensor_msgs/msg/CompressedImage")
Image = load("sensor_msgs/msg/Image")


def stamped(message):
    message.header.stamp.sec, message.header.stamp.nanosec = 1_700_000_000, 5
    message.header.frame_id = "myframe"
    return message


@pytest.mark.parametrize("reliability", ["reliable", "best_effort"])
@pytest.mark.parametrize(
    "message",
    [
        stamped(CompressedImage(format="jpeg", data=JPEG)),
        stamped(Image(height=120, width=160, encoding="bgr8", step=480, data=RAMP)),
    ],
    ids=["jpeg", "raw"],
)  # fmt: skip
def test_pictures_of_rclpy(peer, domain, tmp_path, message, reliability):
    """A JPEG is saved as it is, a raw image as PNG; the file name has the time of the image."""
    topic = f"/pictures/{type(message).__name__}/{reliability}"
    saving = subprocess.Popen(
        [sys.executable, "-m", "uros", "image", "save", topic, "--out", str(tmp_path),
         "--domain", str(domain), "--timeout", str(SECONDS)],
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
    )  # fmt: skip
    try:
        # Samples from before the command's reader is discovered are lost: repeat until it ends.
        while saving.poll() is None:
            peer.do(
                "publish", topic=topic, type=message._TYPE, cdr=[to_cdr(message).hex()],
                reliability=reliability, seconds=1,
            )  # fmt: skip
    finally:
        saving.kill()
        output, _ = saving.communicate()
    assert saving.returncode == 0, output
    (path,) = tmp_path.iterdir()
    assert "_1700000000.000000005." in path.name
    if isinstance(message, CompressedImage):
        assert path.read_bytes() == JPEG
    else:
        width, height, bits, colour, rows = unpacked(path.read_bytes())
        assert (width, height, bits, colour) == (160, 120, 8, 2)
        assert rows[0][:3] == b"\x02\x01\x00"
