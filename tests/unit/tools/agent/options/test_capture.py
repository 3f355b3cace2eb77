"""The options of captures: what they are without being given, and what is refused."""

import argparse
import re

import pytest
from unit.agent.transports.test_process import agent as started
from unit.agent.transports.test_process import refused

from uros.tools.agent import command


def options(*words):
    parser = argparse.ArgumentParser()
    command.add_arguments(parser)
    return command._common(command._parts(parser.parse_args(["udp4", *words])))


def test_there_is_no_capture_by_default():
    found = options()
    assert (found.capture, found.capture_size) == (None, 100)


def test_file_and_size_may_follow_any_transport():
    found = options("--capture", "a.pcapng", "tcp4", "--capture-size", "7")
    assert (found.capture, found.capture_size) == ("a.pcapng", 7)


@pytest.mark.parametrize("size", ["0", "-1", "x", "1.5"])
def test_invalid_sizes(capsys, size):
    with pytest.raises(SystemExit):
        options(f"--capture-size={size}")
    assert "is not an integer above 0" in capsys.readouterr().err


def test_a_file_that_cannot_be_written_ends_the_agent_with_a_line(tmp_path):
    path = tmp_path / "thesis.pcapng"
    path.write_text("my thesis")
    status, said = refused("udp4", "-p", "0", "-m", "memory", "--capture", path)
    assert status == 1 and said.count("\n") == 1
    assert said.endswith(
        "thesis.pcapng is there already and no capture, so it is not overwritten: name another"
        " file, or remove that one\n"
    )
    status, said = refused("udp4", "-p", "0", "-m", "memory", "--capture", "/not/there/x")
    assert status == 1 and "name a file in a folder that exists" in said


def test_state_and_capture_are_two_files(tmp_path):
    (tmp_path / "link").symlink_to(tmp_path / "it")
    files = "--capture", tmp_path / "it", "--state", tmp_path / "link"
    status, said = refused("udp4", "-p", "0", "-m", "memory", *files)
    assert status == 1 and "give each a file of its own" in said
    assert not (tmp_path / "it").exists()


def test_an_agent_logs_the_file_and_the_size_of_its_capture(tmp_path):
    path = tmp_path / "it.pcapng"
    with started("udp4", "-p", 0, "-m", "memory", "--capture", path) as process:
        process.until(r"running\.\.\.")
        assert process.end() == 0
    assert re.search(rf"\| capturing +\| file: {path}\n", process.text)
    assert re.search(rf"\| capture closed +\| file: {path}, messages: 0\n", process.text)
