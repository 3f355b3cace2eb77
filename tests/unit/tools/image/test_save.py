"""``uros image save``: names, numbers and what cannot be written."""

import argparse
import os
import stat

import pytest
from unit.dashboard.test_pictures import JPEG, PNG
from unit.tools.image.test_view import CompressedImage, taken

import uros
from uros.dashboard.pictures import picture
from uros.host.direct import Direct
from uros.host.network import Network
from uros.middleware import open_middleware
from uros.tools.errors import ToolError
from uros.tools.image import save
from uros.tools.image.save import Saver

TOPIC = "/image/compressed"
SECOND = 1_000_000_000


def saver(out, count=0, every=0.0):
    return Saver(TOPIC, str(out), count, every)


def files(folder):
    return sorted(file.name for file in folder.iterdir())


def test_the_stamp_is_in_the_name(tmp_path, capsys):
    saver(tmp_path / "new" / "folder").add(picture(taken(stamp=17)), 18 * SECOND)
    (path,) = (tmp_path / "new" / "folder").iterdir()
    assert path.name == "image_compressed_17.000000000.jpg"
    assert path.read_bytes() == JPEG
    assert capsys.readouterr().out == f"{path}: 16x8, {len(JPEG)} octets, 1.0 s old\n"


def test_without_a_stamp_the_name_has_the_time_of_reception(tmp_path):
    saver(tmp_path).add(picture(taken(PNG, stamp=0)), 18 * SECOND + 5)
    assert files(tmp_path) == ["image_compressed_18.000000005_received.png"]


def test_no_picture_replaces_a_different_one(tmp_path):
    one = saver(tmp_path)
    for _ in range(3):
        one.add(picture(taken(stamp=5)), 0)
    assert files(tmp_path) == [
        "image_compressed_5.000000000.jpg",
        "image_compressed_5.000000000_2.jpg",
        "image_compressed_5.000000000_3.jpg",
    ]


def test_the_number_of_pictures_is_limited(tmp_path):
    one = saver(tmp_path, count=2)
    for stamp in range(1, 5):
        one.add(picture(taken(stamp=stamp)), stamp * SECOND)
    assert one.done and len(files(tmp_path)) == 2


def test_the_period_of_pictures(tmp_path):
    one = saver(tmp_path, every=2.0)
    for tenth in range(0, 60, 5):
        one.add(picture(taken(stamp=100 + tenth)), tenth * SECOND // 10)
    assert [name.split("_")[2][:3] for name in files(tmp_path)] == ["100", "120", "140"]


def test_a_picture_a_second_is_kept_every_second_though_it_comes_a_little_early(tmp_path):
    one = saver(tmp_path, every=1.0)
    for number in range(5):
        one.add(picture(taken(stamp=100 + 10 * number)), number * (SECOND - 300_000))
    assert one.count == 5


def test_one_file(tmp_path):
    path = tmp_path / "one.jpeg"
    one = saver(path, count=1)
    one.add(picture(taken()), 0)
    assert path.read_bytes() == JPEG and files(tmp_path) == ["one.jpeg"]
    umask = os.umask(0)
    os.umask(umask)
    assert stat.S_IMODE(path.stat().st_mode) == 0o666 & ~umask


def test_invalid_output_paths(tmp_path):
    with pytest.raises(ToolError, match="is a file, for --count 1; give a folder"):
        saver(tmp_path / "one.jpg", count=2)
    with pytest.raises(ToolError, match="the images are jpeg: give --out a .jpg name"):
        saver(tmp_path / "one.png", count=1).add(picture(taken()), 0)
    (tmp_path / "file").write_text("")
    with pytest.raises(ToolError, match="cannot be made: "):
        saver(tmp_path / "file" / "below")
    assert files(tmp_path) == ["file"]


def test_a_full_disk_leaves_no_partial_file(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(save.os, "replace", full)
    with pytest.raises(ToolError, match="cannot be written: No space left"):
        saver(tmp_path).add(picture(taken()), 0)
    assert files(tmp_path) == []


# --- the whole ---------------------------------------------------------------------------------


def options(*arguments):
    parser = argparse.ArgumentParser()
    save.add_arguments(parser)
    return parser.parse_args([*arguments])


@pytest.fixture
def camera(own_domain_id, monkeypatch):
    """A node that publishes what ``camera.data`` is while the verb spins; and the verb."""
    node = uros.Node("camera", Direct(open_middleware("auto"), own_domain_id))
    publisher = node.create_publisher(CompressedImage, TOPIC, 10)
    camera = argparse.Namespace(data=JPEG, count=0)

    def spin(self, done, seconds, real=Network.spin):
        if camera.data is not None:
            camera.count += 1
            publisher.publish(taken(camera.data, camera.count))
        node.spin_once(0)
        return real(self, done, min(0.05, seconds or 0.05))

    monkeypatch.setattr(Network, "spin", spin)
    monkeypatch.setattr(save, "discover", lambda network, args: None)
    camera.save = lambda *arguments: save.run(options(*arguments, "--domain", str(own_domain_id)))
    yield camera
    node.destroy_node()


def test_over_dds(camera, tmp_path):
    assert camera.save("--count", "3", "--out", str(tmp_path), "--timeout", "20") == 0
    assert len(files(tmp_path)) == 3
    assert {file.read_bytes() for file in tmp_path.iterdir()} == {JPEG}


def test_no_picture_before_the_timeout_is_an_error(camera, tmp_path, capsys):
    camera.data = None
    assert camera.save("--out", str(tmp_path), "--timeout", "0.2") == 1
    assert "0 of 1 images came within 0.2 s" in capsys.readouterr().err


def test_broken_pictures_are_reported_and_not_written(camera, tmp_path, capsys):
    camera.data = b"<svg>"
    assert camera.save("--out", str(tmp_path), "--timeout", "1") == 1
    assert files(tmp_path) == []
    assert "which is neither JPEG nor PNG" in capsys.readouterr().err
