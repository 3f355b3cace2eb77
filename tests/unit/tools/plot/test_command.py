"""``uros plot`` on a graph of the test's own."""

import io
import sys

import pytest
from unit.host.test_graph_queries import Net

from uros.host import network as network_module
from uros.host.graph_queries import Graph
from uros.host.network import Network, Received
from uros.interfaces import load
from uros.interfaces.codec import to_cdr
from uros.tools import cli


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.fixture
def plot(monkeypatch, own_domain_id, capsys):
    """Runs ``uros plot`` with a topic /imu that has sent two samples; returns what it printed."""
    net = Net()
    participant = net.participant()
    net.endpoint(participant, "rt/imu", "sensor_msgs::msg::dds_::Imu_", True)
    net.endpoint(participant, "rt/imu/x", "std_msgs::msg::dds_::Float64_", True)
    monkeypatch.setattr(network_module, "Graph", lambda source: Graph(net))
    monkeypatch.setattr(Network, "settle", lambda network, seconds=0.0: None)
    message = load("sensor_msgs/msg/Imu")()
    subscribed = []

    def listen(network, topic, type_name, qos, on_sample):
        subscribed.append(topic)
        for value in (1.5, -2.0):
            message.linear_acceleration.x = value
            got = Received(to_cdr(message), 0, 7_000_000_000)
            if topic == "/imu":
                on_sample(got)
        return lambda: None

    def spin(network, done, seconds=None):
        raise KeyboardInterrupt

    monkeypatch.setattr(Network, "listen", listen)
    monkeypatch.setattr(Network, "spin", spin)

    def run(*paths, status=0):
        assert cli.main(["plot", *paths, "--domain", str(own_domain_id)]) == status
        return capsys.readouterr()

    run.subscribed = subscribed
    return run


def test_lines_where_the_output_is_no_terminal(plot):
    out = plot("/imu/linear_acceleration/x", "imu.linear_acceleration.y", "/imu/x/data").out
    assert out.splitlines() == [
        "seconds,name,value",
        "7.000000,/imu/linear_acceleration/x,1.5",
        "7.000000,imu.linear_acceleration.y,0.0",
        "7.000000,/imu/linear_acceleration/x,-2.0",
        "7.000000,imu.linear_acceleration.y,0.0",
    ]
    assert plot.subscribed == ["/imu", "/imu/x"]


def test_ctrl_c_gives_the_terminal_back(plot, monkeypatch):
    terminal = Terminal()
    monkeypatch.setattr(sys, "stdout", terminal)
    plot("/imu/linear_acceleration/x")
    out = terminal.getvalue()
    assert out.startswith("\033[?1049h\033[?25l") and out.endswith("\033[?25h\033[?1049l")
    assert "/imu/linear_acceleration/x: -2  (min -2, max 1.5, 2 points)" in out


def test_a_bag_is_no_topic(plot, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "trip").mkdir()
    assert "'trip' begins with no topic" in plot("trip", status=1).err
    (tmp_path / "trip" / "metadata.yaml").touch()
    (tmp_path / "trip.mcap").touch()
    for path in ("trip", "trip.mcap"):
        said = plot(path, status=1).err
        assert f"'{path}' is a bag, and plot takes topics: 'uros bag play {path}' in" in said


@pytest.mark.parametrize(
    "path, said",
    [
        ("/imu", "/imu is a topic: name a field too, as /imu/FIELD"),
        ("/imi/linear_acceleration/x", "'/imi/linear_acceleration/x' begins with no topic"),
        ("/imu/linear", "sensor_msgs/msg/Imu has no field 'linear'; did you mean 'linear_accel"),
    ],
)
def test_unknown_topics_and_fields(plot, path, said):
    assert said in plot(path, status=1).err
