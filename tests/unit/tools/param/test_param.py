import pytest

from uros.tools import cli


@pytest.mark.parametrize(
    "arguments, status, said",
    [
        (["set", "/x", "a"], 2, "there is no value for the parameter 'a': give PARAMETER VALUE"),
        (["set", "/x", "a", "1", "b"], 2, "there is no value for the parameter 'b'"),
        (["set", "/x", "a", "1", "a", "2"], 2, "the parameter 'a' is given twice"),
        (["set", "/x", "a", "99999999999999999999"], 2, "a: 99999999999999999999 does not fit"),
        (["set", "/x"], 2, "PARAMETER VALUE"),
        (["list", "--filter", "["], 2, "'[' is not a regular expression"),
        (["get", "/x", "a"], 1, "there is no node '/x': no other participant was found in domain"),
        (["load", "/x", "none.yaml"], 1, "none.yaml cannot be read: No such file"),
        (["lst"], 2, "did you mean 'list'"),
    ],
)
def test_errors_of_the_command_line(arguments, status, said, capsys, own_domain_id):
    if status == 1:
        arguments = [*arguments, "--timeout", "0.1", "--domain", str(own_domain_id)]
    assert cli.main(["param", *arguments]) == status
    captured = capsys.readouterr()
    assert said in captured.err and captured.out == ""


def test_an_empty_domain(capsys, own_domain_id):
    assert cli.main(["param", "list", "--domain", str(own_domain_id)]) == 0
    captured = capsys.readouterr()
    assert captured.out == "" and "no other participant was found" in captured.err
