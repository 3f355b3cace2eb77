import json

import pytest
from support.graph_network import GraphNetwork
from unit.host.test_graph_queries import Net, Node

from uros.tools import cli
from uros.tools.param import node
from uros.tools.param.values import Typed, type_name


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


@pytest.fixture
def hidden_node(monkeypatch):
    """A domain with the node /_x, which has no services."""
    net = Net()
    net.participant(nodes=[Node("/", "_x", [], [])])
    return GraphNetwork(net).join(monkeypatch)


VERBS = ["delete {} a", "describe {} a", "dump {}", "get {} a", "list {}", "load {} FILE",
         "set {} a 1"]  # fmt: skip


@pytest.fixture(params=VERBS, ids=lambda words: words.split()[0])
def words(request, tmp_path):
    """Returns the words of a verb for a node."""
    file = tmp_path / "some.yaml"
    file.write_text("/**: {ros__parameters: {a: 1}}")
    return lambda node: ["param", *request.param.format(node).replace("FILE", str(file)).split()]


@pytest.mark.parametrize("option", [[], ["--include-hidden-nodes"]], ids=len)
def test_a_hidden_node_that_is_named_is_meant(hidden_node, words, option, capsys):
    assert cli.main([*words("/_x"), *option]) == 1
    assert "the node /_x has no parameter services" in capsys.readouterr().err


def test_the_timeout_is_that_of_the_search_for_the_node(hidden_node, words, capsys):
    hidden_node.script = [lambda: None] * 2
    for option, seconds in (["--timeout", "2.5"], 2.5), ([], 1.0):
        assert cli.main([*words("/y"), *option]) == 1
        assert hidden_node.waited.pop() == seconds
        assert "there is no node '/y' in domain 0" in capsys.readouterr().err


@pytest.fixture
def node_x(hidden_node, monkeypatch):
    """Gives the node parameter services, which are not called over the network."""
    monkeypatch.setattr(hidden_node.graph, "servers", lambda name: [name])
    return hidden_node


def test_json(node_x, monkeypatch, capsys):
    """An entry for each parameter, with its type on demand."""
    monkeypatch.setattr(node, "list_all", lambda net, nodes, *_: {nodes[0]: ["a", "b.c"]})
    monkeypatch.setattr(node, "types_of_all", lambda *_: {"/_x": {"a": "integer", "b.c": "bool"}})
    assert cli.main(["param", "list", "/_x", "--json"]) == 0
    entries = [{"node": "/_x", "name": "a"}, {"node": "/_x", "name": "b.c"}]
    assert json.loads(capsys.readouterr().out) == entries
    assert cli.main(["param", "list", "/_x", "--json", "--param-type"]) == 0
    kinds = [entry["type"] for entry in json.loads(capsys.readouterr().out)]
    assert kinds == ["integer", "bool"]


@pytest.mark.parametrize(
    "declared, value, remedy",
    [
        (3, Typed(2, 1), "; write 1.0 in place of 1"),
        (3, Typed(4, "fast"), ""),
        (8, Typed(7, [1]), "; write 1.0 in place of 1"),
        (8, Typed(3, 1.0), ""),
        (4, Typed(2, 1), "; put quotes within the quotes: '\"1\"'"),
    ],
)
def test_advice_on_a_value_of_another_type(monkeypatch, declared, value, remedy):
    monkeypatch.setattr(node.ParameterNode, "names", lambda _: ["a"])
    monkeypatch.setattr(node.ParameterNode, "types", lambda *_: [declared])
    advice = node.ParameterNode(None, "/x", None).advice("a", value)
    assert advice == (
        f"a is of the type {type_name(declared)}, and the value of the type"
        f" {type_name(value.kind)}{remedy}"
    )


@pytest.mark.parametrize(
    "typed, kind, value",
    [
        (Typed(2, 7), "integer", 7),
        (Typed(3, float("nan")), "double", "nan"),
        (Typed(4, "a\x1b"), "string", "a\x1b"),
        (Typed(5, b"\x00\xff"), "byte array", [0, 255]),
        (Typed(8, [1.5, float("-inf")]), "double array", [1.5, "-inf"]),
        (Typed(0, None), "not set", None),
    ],
)
def test_get_as_json(node_x, monkeypatch, capsys, typed, kind, value):
    monkeypatch.setattr(node.ParameterNode, "names", lambda _: ["a"])
    monkeypatch.setattr(node.ParameterNode, "get", lambda *_: [typed])
    assert cli.main(["param", "get", "/_x", "a", "--json"]) == 0
    out = capsys.readouterr().out
    assert json.loads(out) == {"node": "/_x", "name": "a", "type": kind, "value": value}
    assert "\x1b" not in out


def test_dump_prints_with_and_without_the_option_of_humble(node_x, monkeypatch, capsys):
    monkeypatch.setattr(node.ParameterNode, "names", lambda _: ["a"])
    monkeypatch.setattr(node.ParameterNode, "get", lambda *_: [Typed(2, 7)])
    for option in ([], ["--print"]):
        assert cli.main(["param", "dump", "/_x", *option]) == 0
        assert capsys.readouterr().out == "/_x:\n  ros__parameters:\n    a: 7\n\n"
