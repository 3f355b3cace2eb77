"""The command line of ``uros agent``: what it takes, and what is made of it."""

import argparse
import gc
import json

import pytest
from support.client import XrceClient
from support.lines import UdpLine
from unit.agent.transports.test_process import agent as process

from uros.agent.server import Server
from uros.agent.transports import rfcomm
from uros.agent.transports.base import TransportError
from uros.middleware import NAMES
from uros.tools import cli
from uros.tools.agent import command
from uros.tools.agent.options.transports import TRANSPORTS, make, make_discovery


def parser():
    one = argparse.ArgumentParser(prog="uros agent")
    command.add_arguments(one)
    return one


def parts(line):
    """The command line, a part for each transport."""
    return command._parts(parser().parse_args(line.split()))


def made(line):
    """The transports of a command line of one transport."""
    (part,) = parts(line)
    return make(part)


def options(line):
    """What is the agent's, of the options of all transports."""
    return command._common(parts(line))


# --- transports -------------------------------------------------------------------------


@pytest.mark.parametrize(
    "line, name, listens_on, port",
    [
        ("udp4", "UDPv4Agent", "0.0.0.0", 8888),
        ("udp4 -p 2019", "UDPv4Agent", "0.0.0.0", 2019),
        ("udp4 -p2019", "UDPv4Agent", "0.0.0.0", 2019),
        ("udp6 --port 0", "UDPv6Agent", "::", 0),
        ("tcp4 --port=65535", "TCPv4Agent", "0.0.0.0", 65535),
        ("tcp6", "TCPv6Agent", "::", 8888),
    ],
)
def test_ports(line, name, listens_on, port):
    (one,) = made(line)
    assert (one.name, one.listens_on, one.port) == (name, listens_on, port)


@pytest.mark.parametrize(
    "line, devices, more",
    [
        ("multiserial --devs /dev/A /dev/B udp4 --port 1", ["/dev/A", "/dev/B"], "udp4"),
        ("multiserial -D /dev/A tcp6", ["/dev/A"], "tcp6"),
        ("multiserial --dev /dev/A serial --dev /dev/B", ["/dev/A"], "serial"),
        ("multiserial --devs /dev/A -b 9600 udp4", ["/dev/A"], "udp4"),
        ("multiserial --devs /dev/A ./udp4", ["/dev/A", "./udp4"], None),
    ],
)
def test_a_transport_ends_the_devices_of_multiserial(line, devices, more):
    first, *rest = parts(line)
    assert first.devs == devices
    assert [part.transport for part in rest] == ([more] if more else [])


def test_a_device_may_have_the_name_of_a_transport():
    (part,) = parts("serial --dev udp4")
    assert part.dev == "udp4"


def test_serial_devices():
    (one,) = made("serial -D /dev/ttyX")
    assert (one.device, one._baud, one._is_file, one._dtr, one._rts) == (
        "/dev/ttyX", 115200, False, None, None
    )  # fmt: skip
    (one,) = made("serial --file /dev/name --baudrate 921600 --dtr on --rts off")
    assert (one.device, one._baud, one._is_file, one._dtr, one._rts) == (
        "/dev/name", 921600, True, True, False
    )  # fmt: skip
    with pytest.raises(SystemExit):
        made("serial -D /dev/ttyX --dtr yes")


def test_several_serial_devices(tmp_path):
    file = tmp_path / "devices"
    file.write_text("/dev/a\n# the arm\n/dev/b\n")
    word = parser().parse_args(["multiserial", "-D", "/dev/a /dev/b", "-b", "9600"])
    for part in (word, *parts("multiserial --devs /dev/a /dev/b -b 9600"),
                 *parts(f"multiserial -f {file} -b 9600")):  # fmt: skip
        assert [(transport.device, transport._baud) for transport in make(part)] == [
            ("/dev/a", 9600),
            ("/dev/b", 9600),
        ]


def test_a_can_interface_and_its_unused_id():
    (one,) = made("canfd --dev can1 --id 0x00000001")
    assert (one._device, one._interface) == ("can1", "socketcan")
    (one,) = made("canfd -D PCAN_USBBUS1 -I 5 --interface pcan")
    assert (one._device, one._interface) == ("PCAN_USBBUS1", "pcan")


def test_bluetooth(monkeypatch):
    monkeypatch.setattr(rfcomm, "bluetooth_socket", lambda: None)
    (one,) = made("rfcomm")
    assert type(one) is rfcomm.RfcommListener
    (one,) = made("rfcomm --address aa:bb:cc:dd:ee:ff --channel 3")
    assert type(one) is rfcomm.RfcommServer
    with pytest.raises(SystemExit):
        made("rfcomm --channel 31")
    with pytest.raises(TransportError, match="not a Bluetooth address"):
        made("rfcomm --address here")


def test_a_custom_transport(tmp_path):
    file = tmp_path / "mine.py"
    file.write_text(
        "class Mine:\n"
        "    framed = False\n"
        "    def __init__(self, *words): self.words = words\n"
        "    def open(self): pass\n"
        "    def close(self): pass\n"
        "    def read(self, timeout): pass\n"
        "    def write(self, data, peer): pass\n"
    )
    (part,) = parts(f"custom {file}:Mine -a one --argument two")
    assert (part.spec, part.arguments) == (f"{file}:Mine", ["one", "two"])
    assert make(part)[0].kind


@pytest.mark.parametrize("name", TRANSPORTS)
def test_every_transport_has_help(name, capsys):
    with pytest.raises(SystemExit) as stop:
        parser().parse_args([name, "--help"])
    assert stop.value.code == 0
    assert TRANSPORTS[name].help in capsys.readouterr().out


# --- options of the agent -----------------------------------------------------------------


def test_options_may_follow_any_transport():
    got = options("udp4 -v 2 -r a.refs tcp4 -m memory -r b.refs serial -D x -v 6 -d")
    assert (got.verbose, got.refs, got.middleware) == (6, ["a.refs", "b.refs"], "memory")
    assert got.discovery == 7400
    assert options("udp4 -v6").verbose == 6
    silent = options("udp4")
    assert (silent.verbose, silent.refs, silent.domain) == (4, [], None)
    assert silent.discovery is None and silent.p2p is None and not silent.stop_at_eof


def test_every_middleware_has_its_name_and_those_of_the_cpp_agent():
    assert set(command._MIDDLEWARES) == set(NAMES)
    for name in NAMES:
        assert options(f"udp4 -m {name}").middleware == name


def test_discovery_and_its_port():
    assert options("udp4 --discovery 7401").discovery == 7401
    line = parts("udp4 -d -p 1 tcp6 -p 2")
    servers = [transport for part in line for transport in make(part)]
    found = make_discovery(command._common(line).discovery, servers)
    assert found.port == 7400 and found._servers == servers


def test_options_without_effect_are_accepted_with_a_warning():
    with process("udp4", "-p", 0, "-m", "ced", "-P", 9999) as one:
        said = one.until(r"warning +\| Root .*\| option ignored +\| (.*)")[1]
        assert said.startswith("--p2p is not supported")
        assert one.end() == 0


@pytest.mark.parametrize("text, domain", [(None, 0), ("", 0), ("7", 7)])
def test_the_domain_of_the_agent_for_boards_that_ask_for_255(text, domain, monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", "42")  # which is for tools: boards ask for theirs
    monkeypatch.delenv("XRCE_DOMAIN_ID_OVERRIDE", raising=False)
    if text is not None:
        monkeypatch.setenv("XRCE_DOMAIN_ID_OVERRIDE", text)
    assert command._domain_of_agent() == domain
    assert options("udp4").domain is None


def test_each_line_of_a_json_log_is_an_object_from_the_first_to_the_last():
    with process("udp4", "-p", 0, "-m", "memory", "--log-format", "json", "-v", 6) as one:
        port = int(one.until(r"\"running...\", \"about\": \"port: (\d+)")[1])
        line = UdpLine(port)
        client = XrceClient(line, 0x4B0CBE99)
        client.open()
        client.participant("\x1b[2J\n{}")
        line.close()
        assert one.end() == 0
        logged = [json.loads(text) for text in one.text.splitlines()]
    keys = {"time", "level", "part", "function", "event", "about"}
    assert all(set(each) - {"client_key"} == keys for each in logged)
    events = [each["event"] for each in logged if each.get("client_key") == "0x4B0CBE99"]
    assert {"create", "session established", "delete"} <= set(events)
    assert logged[-1]["event"] == "server stopped"


# --- groups of options ----------------------------------------------------------------------


@pytest.mark.parametrize("group", command._GROUPS, ids=lambda group: group._title or "general")
def test_each_group_has_defaults_for_exactly_its_options(group):
    common = argparse.ArgumentParser(add_help=False)
    group.declare(common)
    assert {action.dest for action in common._actions} == set(group.defaults)
    assert all(action.default is argparse.SUPPRESS for action in common._actions)
    assert [group.title for group in common._action_groups if group._group_actions]


# --- a wrong transport ------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([], "uros agent: error: name a transport (udp4, udp6, tcp4, tcp6, serial, "),
        ([], "such as: uros agent udp4 --port 8888"),
        (["udp"], "; did you mean 'udp4' or 'udp6'?"),
        (["UDP4"], "; did you mean 'udp4'?"),
        (["udp4", "seriall"], "; did you mean 'serial'?"),
        (["bluetooth"], "choose from"),
        (["udp4", "-m", "ddss"], "; did you mean 'dds'?"),
    ],
)
def test_a_missing_or_unknown_transport_lists_the_known_ones(arguments, said, capsys):
    assert cli.main(["agent", *arguments]) == 2
    printed = capsys.readouterr()
    assert said in printed.err and printed.out == ""


def test_full_garbage_collections_leave_out_what_was_there_before_the_agent_serves(monkeypatch):
    """One of all of it would keep the boards waiting for 10 ms."""
    frozen = []
    monkeypatch.setattr(Server, "run", lambda server: frozen.append(gc.get_freeze_count()))
    try:
        assert cli.main(["agent", "udp4", "-p", "0", "-m", "memory", "--no-inspection"]) == 0
        assert frozen[0] > 10_000
    finally:
        gc.unfreeze()
