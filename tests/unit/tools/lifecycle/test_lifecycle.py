import json
from types import SimpleNamespace

import pytest

from uros.tools import cli
from uros.tools.errors import ToolError
from uros.tools.lifecycle import get
from uros.tools.lifecycle.set import _chosen


@pytest.mark.parametrize(
    "arguments, status, said",
    [
        (["get", "/x"], 1, "there is no node '/x': no other participant was found in domain"),
        (["set", "/x"], 2, "TRANSITION"),
        (["list", "/x", "--timeout", "0"], 2, "'0' is not a number above 0"),
        (["node"], 2, "did you mean 'nodes'?"),
    ],
)
def test_errors_of_the_command_line(arguments, status, said, capsys, own_domain_id):
    if status == 1:
        arguments = [*arguments, "--timeout", "0.1", "--domain", str(own_domain_id)]
    assert cli.main(["lifecycle", *arguments]) == status
    captured = capsys.readouterr()
    assert said in captured.err and captured.out == ""


def test_an_empty_domain(capsys, own_domain_id):
    for arguments, printed in ((["nodes", "-c"], "0\n"), (["get"], "")):
        assert cli.main(["lifecycle", *arguments, "--domain", str(own_domain_id)]) == 0
        captured = capsys.readouterr()
        assert captured.out == printed and "no other participant was found" in captured.err


def test_states_as_json(monkeypatch, capsys, own_domain_id):
    """An object for each node, and for the node that is named the object alone."""
    found = {"/a": SimpleNamespace(id=3, label="active"), "/b": ToolError("no answer")}
    monkeypatch.setattr(get, "lifecycle_nodes", lambda *_: ["/a", "/b"])
    monkeypatch.setattr(get, "find_lifecycle_node", lambda network, args: args.node)
    monkeypatch.setattr(
        get, "states", lambda network, nodes, seconds: {node: found[node] for node in nodes}
    )
    words = ["lifecycle", "get", "--json", "--domain", str(own_domain_id), "--spin-time", "0.1"]
    entry = {"name": "/a", "state": "active", "id": 3}
    assert cli.main([*words, "/a"]) == 0
    assert json.loads(capsys.readouterr().out) == entry
    assert cli.main(words) == 1
    captured = capsys.readouterr()
    assert json.loads(captured.out) == [entry] and "no answer" in captured.err


def test_a_label_takes_precedence_over_a_number():
    one, two = SimpleNamespace(id=1, label="2"), SimpleNamespace(id=2, label="go")
    again = SimpleNamespace(id=3, label="go")
    transitions = [one, two, again]
    assert _chosen("2", transitions) is one and _chosen("go", transitions) is two
    assert _chosen("3", transitions) is again and _chosen("x", transitions) is None
