"""Configuration files: they have every option of the command line, and their mistakes are named."""

import argparse

import pytest
from unit.agent.transports.test_process import agent as process
from unit.agent.transports.test_process import refused

from uros.agent.policy.config_values import ConfigError
from uros.tools.agent import command
from uros.tools.agent.config.file import Config
from uros.tools.agent.config.schema import TransportKeys, tables
from uros.tools.agent.options.rules import make_rules
from uros.tools.agent.options.transports import TRANSPORTS, make

UDP = '[[transport]]\ntype = "udp4"\nport = 0\n'


@pytest.fixture
def read(tmp_path):
    """Return the configuration of a text."""

    def config(text):
        path = tmp_path / "agent.toml"
        path.write_text(text)
        return Config(str(path), command._GROUPS)

    return config


def parser():
    one = argparse.ArgumentParser(prog="uros agent")
    command.add_arguments(one)
    return one


def given(line):
    """The parts of a command line."""
    return command._parts(parser().parse_args(line.split()))


# --- one source of truth --------------------------------------------------------------------


def test_every_option_of_the_command_line_is_a_key_and_every_key_an_option():
    choices = parser()._subparsers._group_actions[0].choices
    agent_keys = {
        key.attribute for keys in tables(command._GROUPS).values() for key in keys.values()
    }
    for name in TRANSPORTS:
        options = {action.dest for action in choices[name]._actions} - {"help", "more", "config"}
        own = {key.attribute for key in TransportKeys(name).keys.values()}
        assert options == agent_keys | own and not agent_keys & own, name
    assert len(agent_keys) > 20


def test_every_option_may_come_before_the_first_transport():
    hidden = {
        action.dest.removeprefix(command._FIRST)
        for action in parser()._actions
        if action.dest.startswith(command._FIRST)
    }
    assert hidden == set(command._DEFAULTS)
    shown = parser().format_help()
    assert "--config FILE" in shown and "--max-memory" not in shown


# A value for each key of the agent that a test can give, and the option as the command line has it.
VALUES = {
    "middleware": ('"memory"', "-m memory"),
    "distro": ('"humble"', "--distro humble"),
    "refs": ('["/a.xml", "/b.xml"]', "--refs /a.xml --refs /b.xml"),
    "verbose": ("6", "-v 6"),
    "log_format": ('"json"', "--log-format json"),
    "discovery": ("7401", "--discovery 7401"),
    "p2p": ("9999", "--p2p 9999"),
    "stop_at_eof": ("true", "--stop-at-eof"),
    "domain": ("7", "--domain 7"),
    "namespace": ('"/hall"', "--namespace /hall"),
    "remap": ('{ "/a" = "/b" }', "--remap /a:=/b"),
    "qos": (
        '{ "/a" = { depth = 1, reliability = "reliable" } }',
        "--qos /a:depth=1,reliability=reliable",
    ),
    "max_rate": ("2.5", "--max-rate 2.5"),
    "max_size": ("100", "--max-size 100"),
    "control": ('["/rules.toml"]', "--control /rules.toml"),
    "allow_key": ('["0x11", 7]', "--allow-key 0x11 --allow-key 7"),
    "allow_net": ('["10.0.0.0/8"]', "--allow-net 10.0.0.0/8"),
    "max_clients": ("20", "--max-clients 20"),
    "dead_time": ("0", "--dead-time 0"),
    "max_objects": ("100", "--max-objects 100"),
    "max_message": ("1000", "--max-message 1000"),
    "max_memory": ("16", "--max-memory 16"),
    "state": ('"/run/state"', "--state /run/state"),
    "capture": ('"/tmp/a.jsonl"', "--capture /tmp/a.jsonl"),
    "capture_size": ("5", "--capture-size 5"),
    "audit": ('"/tmp/audit"', "--audit /tmp/audit"),
    "audit_size": ("5", "--audit-size 5"),
    "inspection": ("false", "--no-inspection"),
    "metrics": ('"[::1]:9100"', "--metrics [::1]:9100"),
    "diagnostics": ("2", "--diagnostics 2"),
    "diagnostics_node": ('"arm"', "--diagnostics-node arm"),
}


def test_each_key_has_the_value_that_its_option_has_on_the_command_line(read):
    lines = []
    known = tables(command._GROUPS)
    for table, keys in known.items():
        lines.append(f"[{table}]")
        lines += [f"{key.name} = {VALUES[key.attribute][0]}" for key in keys.values()]
    config = read("\n".join(lines))
    assert config.problems == []
    words = " ".join(option for _, option in VALUES.values())
    want = vars(command._common(given(f"udp4 {words}")))
    assert {**command._DEFAULTS, **config.options} == want


TRANSPORT_VALUES = {
    "udp4": ("port = 2019", "-p 2019"),
    "udp6": ("", ""),
    "tcp4": (
        'port = 1\ntls_cert = "/c"\ntls_key = "/k"\ntls_ca = "/a"\ntls_crl = "/r"',
        "-p 1 --tls-cert /c --tls-key /k --tls-ca /a --tls-crl /r",
    ),
    "tcp6": ("port = 0", "-p 0"),
    "serial": (
        'dev = "/dev/x"\nbaudrate = 9600\ndtr = true\nrts = "off"',
        "-D /dev/x -b 9600 --dtr on --rts off",
    ),
    "multiserial": ('devs = ["/dev/a", "/dev/b"]', "-D /dev/a /dev/b"),
    "pseudoterminal": ("baudrate = 9600", "-b 9600"),
    "canfd": (
        'dev = "can1"\ninterface = "pcan"\nid = "5"', "-D can1 --interface pcan --id 5"
    ),
    "rfcomm": (
        'address = "aa:bb:cc:dd:ee:ff"\nchannel = 3', "--address aa:bb:cc:dd:ee:ff --channel 3"
    ),
    "custom": ('spec = "mine.py:Mine"\narguments = ["one", "two"]', "mine.py:Mine -a one -a two"),
}  # fmt: skip


@pytest.mark.parametrize("name", TRANSPORTS)
def test_a_transport_has_the_options_that_it_has_on_the_command_line(read, name):
    text, words = TRANSPORT_VALUES[name]
    config = read(f'[[transport]]\ntype = "{name}"\n{text}\n')
    assert config.problems == []
    (part,) = config.transports
    (line,) = given(f"{name} {words}")
    want = {key: value for key, value in vars(line).items() if key in vars(part)}
    assert vars(part) == want
    keys = TransportKeys(name).keys.values()
    assert {key.attribute for key in keys} | {"transport", "more"} == set(vars(part))


def test_switches_and_optional_values(read):
    config = read("[agent]\ndiscovery = true\n[monitoring]\ndiagnostics = true\n")
    assert (config.options["discovery"], config.options["diagnostics"]) == (7400, 1.0)
    config = read("[agent]\ndiscovery = false\n[monitoring]\ninspection = true\n")
    assert "discovery" not in config.options and config.options["inspection"] is True


def test_relative_paths_start_from_the_folder_of_the_file(read, tmp_path):
    config = read('[agent]\nstate = "agent.state"\n[[transport]]\ntype = "serial"\nfile = "dev"\n')
    assert config.options["state"] == str(tmp_path / "agent.state")
    assert config.transports[0].file == str(tmp_path / "dev")


@pytest.mark.parametrize(
    "device", ["COM3", "com12", "socket://host:1", "rfc2217://host:1", "/dev/ttyACM0"]
)
def test_devices_that_are_no_relative_paths_stay_as_they_are(read, device):
    config = read(
        f'[[transport]]\ntype = "serial"\ndev = "{device}"\n'
        f'[[transport]]\ntype = "multiserial"\ndevs = ["{device}"]\n'
        '[[transport]]\ntype = "canfd"\ndev = "can0"\n'
    )
    one, several, can = config.transports
    assert (one.dev, several.devs, can.dev) == (device, [device], "can0")


def test_relative_devices_start_from_the_folder_of_the_file(tmp_path):
    folder = tmp_path / "a folder"
    folder.mkdir()
    path = folder / "agent.toml"
    path.write_text(
        '[[transport]]\ntype = "serial"\ndev = "left"\n'
        '[[transport]]\ntype = "multiserial"\ndevs = ["right up", "/dev/ttyUSB0"]\n'
    )
    one, several = Config(str(path), command._GROUPS).transports
    assert one.dev == str(folder / "left")
    servers = make(several)
    assert [server.device for server in servers] == [
        str(folder / "right"), str(folder / "up"), "/dev/ttyUSB0"
    ]  # fmt: skip


# --- the command line wins ---------------------------------------------------------------------


def test_the_command_line_wins_over_the_file(read):
    config = read(
        '[agent]\nverbose = 2\nmiddleware = "memory"\nrefs = ["/a"]\n'
        "[admission]\nkeys = [1, 2]\n[limits]\nmax_memory = 16\n"
    )
    options = command._common(given("-v 5 udp4 --allow-key 3 -r /b"), config)
    assert (options.verbose, options.middleware, options.max_memory) == (5, "memory", 16)
    assert (options.allow_key, options.refs) == (["3"], ["/b"])
    assert command._common([], config).allow_key == ["1", "2"]


def test_the_order_of_rules(read, tmp_path):
    (tmp_path / "rules.toml").write_text("[[client]]\nkey = [2, 3, 4]\nnamespace = '/file'\n")
    config = read(
        '[rules]\nnamespace = "/all"\nmax_size = 9\nmax_rate = 8\ncontrol = "rules.toml"\n'
        '[[client]]\nkey = [3, 4]\nnamespace = "/client"\n'
    )
    options = command._common(given("udp4 --max-rate 5"), config)
    rules = make_rules(options, config)
    found = {key: rules.settings(key, "", "/n").namespace for key in (1, 2, 3)}
    assert found == {1: "/all", 2: "/file", 3: "/client"}
    settings = rules.settings(3, "", "/n")
    assert (settings.max_size, settings.max_rate) == (9, 5.0)
    rules = make_rules(command._common(given("udp4 --namespace /line"), config), config)
    assert rules.settings(3, "", "/n").namespace == "/line"


# --- mistakes ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "line", "said"),
    [
        ("[agent]\nverbos = 3\n", 2, "[agent] has no 'verbos'; did you mean 'verbose'?"),
        ("[agent]\n\nmax-memory = 3\n", 3, "[agent] has no 'max-memory'; there are "),
        ("[limits]\nmax-memory = 3\n", 2, "[limits] has no 'max-memory': write max_memory (with"),
        ("[agent]\nmax_memory = 3\n", 2, "[agent] has no 'max_memory': it belongs into [limits]"),
        ("state = '/a'\n", 1, "state belongs into the table [agent]"),
        ("[agnet]\nverbose = 3\n", 1, "there is no table 'agnet'; did you mean 'agent'?"),
        ("agent = 3\n", 1, "agent is a table: write [agent]"),
        ("[udp4]\nport = 3\n", 1, '[udp4]: write [[transport]] and type = "udp4"'),
        ("[zzz]\n", 1, "there is no table 'zzz'; there are [agent], [rules], "),
        ("[transport]\ntype = 'udp4'\n", 1, "with two brackets"),
        ("[client]\nkey = 1\n", 1, "with two brackets"),
        ("[agent]\nverbose = 7\n", 2, "verbose: '7' is not a verbosity (0 to 6)"),
        ("[agent]\nverbose = [1]\n", 2, "verbose is [1], not a number or a text"),
        ("[agent]\nverbose = true\n", 2, "verbose is True, not a number or a text"),
        ("[agent]\nstate = 3\n", 2, "state is 3, not a text"),
        ("[agent]\nstate = ''\n", 2, "state is '', not a text"),
        ("[agent]\nmiddleware = 'ddss'\n", 2, "middleware is 'ddss'; did you mean 'dds'?"),
        ("[agent]\nmiddleware = 'zzz'\n", 2, "middleware is 'zzz', not one of auto, dds, "),
        ("[agent]\np2p = 'x'\n", 2, "p2p is 'x', not a number"),
        ("[agent]\nconfig = 'x'\n", 2, "[agent] has no 'config'"),
        ("[monitoring]\ninspection = 1\n", 2, "inspection is 1, not true or false"),
        ("[admission]\nkeys = []\n", 2, "keys is empty: leave it out"),
        ("[rules]\nqos = { '/a' = 3 }\n", 2, "/a is 3, not a table"),
        (UDP + "prot = 3\n", 4, "the udp4 transport has no 'prot'; did you mean 'port'?"),
        (UDP + "state = 'a'\n", 4, "the udp4 transport has no 'state': it belongs into [agent]"),
        ("[[transport]]\nport = 1\n", 1, 'the transport has no type: write type = "udp4"'),
        ("[[transport]]\ntype = 'udp5'\n", 2, "there is no type 'udp5'; did you mean 'udp"),
        ("[[transport]]\ntype = 4\n", 2, "there is no type 4; there are udp4, "),
        ("[[transport]]\ntype = 'serial'\n", 1, "the serial transport needs dev or file"),
        ("[[transport]]\ntype = 'canfd'\n", 1, "the canfd transport needs dev"),
        ("[[transport]]\ntype = 'custom'\n", 1, "the custom transport needs spec"),
        ("[[transport]]\ntype = 'serial'\ndev = 'a'\nfile = 'b'\n", 4, "exclude each other"),
        ("[[transport]]\ntype = 'tcp4'\ntls-cert = 'a'\n", 3, "write tls_cert (with _)"),
        ("[[client]]\nkey = 1\nnamespce = '/a'\n", 3, "did you mean 'namespace'?"),
        ("[[client]]\nkey = 1\n", 1, "it does nothing; it may have domain, "),
        ("[[client]]\ndomain = 1\n[[client]]\nkey = 'zz'\ndomain = 1\n", 4, "key is 'zz'"),
    ],
)  # fmt: skip
def test_a_mistake_is_named_with_its_line_and_what_was_meant(read, text, line, said):
    config = read(text)
    (problem,) = config.problems
    assert said in problem.text and problem.line == line, problem
    assert str(problem) == f"{config.path}:{line}: {problem.text}"


def test_all_mistakes_are_found_at_once(read):
    config = read("[agent]\na = 1\nb = 2\n[limits]\nmax_objects = 0\n" + UDP + "c = 3\n")
    assert [problem.line for problem in config.problems] == [2, 3, 5, 9]
    assert config.transports == []


def test_a_file_that_is_no_toml_is_named_with_the_line(read, tmp_path):
    with pytest.raises(ConfigError, match=r"agent.toml: no TOML: .*at line 2, column "):
        read("[agent]\nverbose = \n")


# --- an agent with a file ---------------------------------------------------------------------


def test_an_agent_starts_from_a_file_alone(tmp_path):
    path = tmp_path / "agent.toml"
    path.write_text('[agent]\nmiddleware = "memory"\nverbose = 5\n' + UDP)
    with process("--config", path) as one:
        one.until(r"verbose_level: 5")
        one.until(r"UDPv4Agent +\| init .*port: (\d+)")
        assert one.end() == 0
    with process("--config", path, "-v", 4, "tcp4", "-p", 0) as one:
        one.until(r"TCPv4Agent +\| init .*port: (\d+)")
        assert one.end() == 0
        assert "UDPv4Agent" not in one.text and "verbose_level: 4" in one.text
    with process("udp6", "-p", 0, "--config", path) as one:
        one.until(r"UDPv6Agent +\| init .*port: (\d+)")
        assert one.end() == 0


def test_an_agent_with_a_bad_file_does_not_start(tmp_path):
    path = tmp_path / "agent.toml"
    path.write_text("[agent]\nverbos = 3\n" + UDP + "prot = 1\n")
    status, output = refused("--config", path)
    assert status == 1
    assert output == (
        f"uros: {path}:2: [agent] has no 'verbos'; did you mean 'verbose'?"
        f" (and 1 more: uros agent check {path})\n"
    )
    status, output = refused("--config", tmp_path / "none.toml")
    assert (status, output) == (1, f"uros: {tmp_path}/none.toml: No such file or directory\n")


def test_a_file_without_a_transport_needs_one_on_the_command_line(tmp_path):
    path = tmp_path / "agent.toml"
    path.write_text('[agent]\nmiddleware = "memory"\n')
    status, output = refused("--config", path)
    assert status == 2 and "name a transport" in output
    assert f"or give {path} a [[transport]]" in " ".join(output.split())
    status, output = refused("-v", 5)
    assert status == 2 and "name a transport" in output
