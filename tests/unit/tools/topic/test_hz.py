import pytest
from support.graph_network import GraphNetwork
from unit.host.test_graph_queries import STRING, Net

from uros.host.network import Received
from uros.interfaces import load
from uros.interfaces.codec import to_cdr
from uros.tools import cli
from uros.tools.topic.hz import Rate, report

MS = 1_000_000


def fed(*times, window=10000):
    rate = Rate(window)
    for time in times:
        rate.add(time * MS)
    return rate


def test_one_message_is_no_rate():
    assert report({"/x": fed()}, True) == ""
    assert report({"/x": fed(0)}, True) == ""


def test_the_output_is_that_of_ros2():
    assert report({"/x": fed(0, 100, 210, 300)}, True) == (
        "average rate: 10.000\n\tmin: 0.090s max: 0.110s std dev: 0.00816s window: 3\n"
    )


def test_a_rate_without_new_messages_is_not_printed_again():
    rate = fed(0, 100)
    assert report({"/x": rate}, True)
    assert report({"/x": rate}, True) == ""
    rate.add(200 * MS)
    assert report({"/x": rate}, True)


def test_the_window():
    stats = fed(0, 1000, 1100, 1200, window=2).statistics()
    assert stats.window == 2 and stats.rate == pytest.approx(10)


def test_messages_at_one_instant():
    assert fed(5, 5).statistics().rate == 0.0


def test_several_topics_are_a_table():
    text = report({"/x": fed(0, 100), "/longer": fed(0, 50), "/silent": fed()}, False)
    head, line, x, longer, end, last = text.split("\n")
    assert head.split() == ["topic", "rate", "min_delta", "max_delta", "std_dev", "window"]
    assert set(line) == {"="}
    assert x.split() == ["/x", "10.000", "0.100", "0.100", "0.00000", "1"]
    assert longer.split()[:2] == ["/longer", "20.000"]
    assert (end, last) == ("", "")
    assert report({"/x": fed(0)}, False) == ""


def test_a_reset_forgets_all():
    rate = fed(0, 100)
    rate.reset()
    assert rate.statistics() is None
    rate.add(0)
    rate.add(50 * MS)
    assert rate.statistics().rate == pytest.approx(20)


@pytest.mark.parametrize(
    "arguments, status, said",
    [
        ([], 2, "give the names of topics, or --all"),
        (["/x", "-a"], 2, "give either topics or --all"),
        (["/x", "-w", "0"], 2, "'0' is not an integer above 0"),
        (["/x", "--filter", "1 +"], 2, "--filter '1 +': no expression"),
        (["/x", "--filter", "x.data"], 2, "there is no 'x' here, only the message m"),
        (["/x", "--qos-reliability", "best"], 2, "invalid choice: 'best'"),
    ],
)
def test_a_wrong_command_line(arguments, status, said, capsys, own_domain_id):
    assert cli.main(["topic", "hz", *arguments, "--domain", str(own_domain_id)]) == status
    captured = capsys.readouterr()
    assert said in captured.err and captured.out == ""


def test_all_topics_of_an_empty_domain(capsys, own_domain_id):
    assert cli.main(["topic", "hz", "-a", "--domain", str(own_domain_id)]) == 0
    assert capsys.readouterr().out == "No topics available\n"


# --- with messages ------------------------------------------------------------------------------


@pytest.fixture
def measured(monkeypatch, capsys):
    """Measures /x, to which a message comes each 0.1 s of the system; returns the output."""
    net = Net()
    net.endpoint(net.participant(), "rt/x", STRING, True)
    network = GraphNetwork(net).join(monkeypatch)

    def receive():
        for number in range(1, 4):
            if "/clock" in network.listening:
                time = load("builtin_interfaces/msg/Time")(sec=number)
                clock = load("rosgraph_msgs/msg/Clock")(clock=time)
                network.listening["/clock"](Received(to_cdr(clock), 0, 0))
            cdr = to_cdr(load("std_msgs/msg/String")(data="x" * number))
            network.listening["/x"](Received(cdr, 0, number * 100 * MS))

    def run(*options):
        network.script = [receive]
        assert cli.main(["topic", "hz", "/x", *options]) == 0
        return capsys.readouterr().out

    return run


@pytest.mark.parametrize(
    "options, rate",
    [
        ([], "10.000"),
        (["-s"], "1.000"),
        (["-s", "--wall-time"], "10.000"),
        (["--wall-time"], "10.000"),
        (["--filter", "len(m.data) != 2"], "5.000"),
    ],
)
def test_the_rate_is_of_the_systems_time_or_of_the_clock(measured, options, rate):
    assert measured(*options).startswith(f"average rate: {rate}\n")
