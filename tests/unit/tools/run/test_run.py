import io
import subprocess
import sys

import pytest

from uros.tools import cli
from uros.tools.run import command

TALKER = "import sys; from uros.tools.cli import main; sys.exit(main(['run', 'talker']))"


@pytest.mark.parametrize(
    "arguments, said",
    [
        (["run"], "name a node to run (nodes: talker, listener, trigger_service)"),
        (["run", "talkr"], "there is no node 'talkr'; did you mean 'talker'?"),
        (["run", "talker", "-r", "chatter"], "--remap: 'chatter' is no remapping rule"),
    ],
)
def test_errors_of_the_command_line(arguments, said, capsys):
    assert cli.main(arguments) == 1
    assert said in capsys.readouterr().err


def test_an_executable_of_a_ros_package(capsys):
    assert cli.main(["run", "demo_nodes_cpp", "talker"]) == 2
    said = "nodes of ROS packages are run by 'ros2 run' of ROS 2"
    assert said in capsys.readouterr().err
    assert cli.main(["run", "--help"]) == 0
    assert "executable" not in capsys.readouterr().out


def test_the_list_has_the_place_of_each_node(capsys):
    assert cli.main(["run", "--list"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == list(command.PROGRAMS)
    assert lines[0].endswith("(uros.tools.run.talker)")


def test_a_node_ends_when_its_output_is_closed():
    process = subprocess.Popen(
        [sys.executable, "-c", TALKER], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        assert "Publishing: 'Hello World: 1'" in process.stdout.readline()
        process.stdout.close()
        assert process.wait(30) == 141
        assert process.stderr.read() == ""
    finally:
        process.kill()
        process.wait()
        process.stderr.close()


def test_lines_are_flushed_and_a_closed_pipe_is_no_error():
    class Gone(io.StringIO):
        def flush(self):
            raise BrokenPipeError

    out = io.StringIO()
    lines = command._Lines(out)
    print("one", file=lines)
    assert out.getvalue() == "one\n" and not lines.ended
    gone = command._Lines(Gone())
    print("one", file=gone)
    print("two", file=gone)
    assert gone.ended
