import pytest

from uros.tools import cli


@pytest.mark.parametrize(
    "arguments, status, said",
    [
        (["call", "/x", "std_srvs/Triger"], 1, "unknown type 'std_srvs/srv/Triger' (did you mean"),
        (["call", "/x", "std_msgs/msg/String"], 1, "std_msgs/msg/String is not a service"),
        (["call", "/x", "std_srvs/SetBool", "{dat: 1}"], 1, "has no field 'dat'; it has data"),
        (["call", "/x", "std_srvs/SetBool", "data: 3"], 1, "SetBool_Request.data takes true or"),
        (["call", "/x", "std_srvs/Trigger", "-r", "0"], 2, "'0' is not a number above 0"),
        (["call", "/x", "std_srvs/Trigger", "--timeout", "x"], 2, "'x' is not a number above 0"),
        (["call", "/x", "-m", "ros2"], 1, "-m ros2 needs rclpy, which this Python"),
        (["call", "/x", "-m", "memory"], 2, "invalid choice: 'memory'"),
        (["call", "/1x"], 2, "'/1x' is not a service name"),
        (["call"], 2, "NAME"),
        (["type", "/x"], 1, "there is no service '/x': no other participant was found in domain"),
        (["info", "/x"], 1, "there is no service '/x': no other participant was found in domain"),
        (["echo", "/x"], 1, "there is no service '/x': no other participant was found in domain"),
        (["echo", "/x", "std_srvs/Triger"], 1, "unknown type 'std_srvs/srv/Triger' (did you mean"),
        (["echo", "/x", "std_msgs/msg/String"], 1, "std_msgs/msg/String is not a service"),
        (["echo", "/x", "--truncate-length", "-1"], 2, "'-1' is not an integer of 0 or more"),
        (["call", "/x", "--qos-depth", "x"], 2, "'x' is not an integer of 0 or more"),
        (["typ"], 2, "did you mean 'type'?"),
    ],
)
def test_errors_of_the_command_line(arguments, status, said, capsys, own_domain_id):
    if status == 1:
        arguments = [*arguments, "--domain", str(own_domain_id)]
    assert cli.main(["service", *arguments]) == status
    captured = capsys.readouterr()
    assert said in captured.err and captured.out == ""


def test_an_empty_domain(capsys, own_domain_id):
    for verb, said in (("list", ""), ("find", "0\n")):
        arguments = ["std_srvs/Trigger", "-c"] if verb == "find" else []
        assert cli.main(["service", verb, *arguments, "--domain", str(own_domain_id)]) == 0
        assert capsys.readouterr().out == said
