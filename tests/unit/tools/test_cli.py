import os
import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

import uros
from uros.interfaces import InterfaceError
from uros.middleware.base import MiddlewareError
from uros.tools import cli
from uros.tools.agent import running_agents
from uros.tools.agent.unseen import agents_reasons
from uros.tools.common import remedy
from uros.tools.errors import ToolError
from uros.tools.topic import list as topic_list

HEAVY = ("cyclonedds", "numpy", "ctypes", "rclpy", "uros.middleware", "uros.interfaces")

# The last line tells the CPU time and which of the heavy modules were loaded.
PROBE = f"""
import resource, sys
sys.argv[0] = "uros"
try:
    {{0}}
except SystemExit as stop:
    assert not stop.code, stop.code
used = resource.getrusage(resource.RUSAGE_SELF)
loaded = [name for name in {HEAVY!r} if name in sys.modules]
print(used.ru_utime + used.ru_stime, *loaded)
"""


@pytest.mark.parametrize(
    "code",
    [
        "import uros",
        "from uros.tools.cli import main; main(['--help'])",
        "from uros.tools.cli import main; main([])",
        "from uros.tools.cli import main; main(['--version'])",
        "from uros.tools.cli import main; main(['topic', '--help'])",
        "from uros.tools.cli import main; main(['topic', 'echo', '--help'])",
        "from uros.tools.cli import main; main(['node', 'info', '--help'])",
    ],
)
def test_help_loads_nothing_heavy(code, record_property):
    done = subprocess.run(
        [sys.executable, "-c", PROBE.format(code)], capture_output=True, text=True, check=True
    )
    cpu, *loaded = done.stdout.splitlines()[-1].split()
    record_property("cpu_seconds", cpu)  # reported, not judged: machines differ
    print(f"{cpu} s of CPU: {code}")
    assert loaded == []


def test_alone_it_prints_help(capsys):
    assert cli.main([]) == 0
    printed = capsys.readouterr().out
    for name in ("agent", "demo", "topic", "node"):
        assert f"\n  {name} " in printed
    assert cli.main(["topic"]) == 0
    assert "hz" in capsys.readouterr().out


def test_version(capsys):
    assert cli.main(["--version"]) == 0
    assert capsys.readouterr().out == f"uros {uros.__version__}\n"


@pytest.mark.parametrize(
    "arguments, said",
    [
        (["topc"], "did you mean 'topic'? (help"),
        (["zzz"], "commands: agent, demo, topic, node"),
        (["topic", "ech"], "uros topic: error: there is no command 'ech'; did you mean 'echo'?"),
        (
            ["launch", "x"],
            "there is no command 'launch'; boards are ordinary nodes for 'ros2 launch' of",
        ),
        (["status"], "there is no command 'status'; did you mean 'uros agent status'? (help"),
        (["record"], "did you mean 'uros bag record'?"),
        (
            ["echo", "/x"],
            "did you mean 'uros topic echo' or 'uros service echo' or 'uros action echo'"
            " or others?",
        ),
        (["wtf"], "'wtf'; uros doctor does that (help"),
        (["daemon", "stop"], "'daemon'; there is no daemon to start or stop: each command"),
        (["pkg", "list"], "'pkg'; uros makes no ROS packages: 'uros board new' begins"),
        (["security", "x"], "keystores of DDS are for 'ros2 security' of ROS 2"),
        (["extensions"], "uros has no plug-ins, which 'ros2 extensions' of ROS 2 lists"),
        (["component", "list"], "boards are ordinary nodes for 'ros2 component' of ROS 2"),
        (["topic", "daemon"], "uros topic: error: there is no command 'daemon' (commands: bw, "),
        (["--topic"], "unrecognized arguments: --topic"),
        (["topic", "echo", "/x", "--onec"], "--onec; did you mean '--once'?"),
        (["topic", "list", "extra"], "unrecognized arguments: extra (help"),
        # many options are not listed, few are
        (["topic", "list", "-m", "memory"], "-m memory (help"),
        (["topic", "echo", "/x", "--josn"], "unrecognized arguments: --josn (help"),
        (["completion", "-m"], "unrecognized arguments: -m (options: --help) (help"),
        (["agent", "udp"], "invalid choice: 'udp'; did you mean 'udp4' or 'udp6'? (help"),
        (["agent", "quic"], "invalid choice: 'quic' (choose from "),
        (["agent", "udp4", "--prot", "1"], "uros agent udp4: error: unrecognized"),
        (["agent", "udp4", "tcp4", "--prot", "1"], "--prot; did you mean '--port'?"),
        (["topic", "echo"], "TOPIC"),
        (["topic", "echo", "/a b"], "'/a b' is not a topic name"),
        (["topic", "info", "1x"], "'1x' is not a topic name"),
        (["topic", "list", "--domain", "233"], "'233' is not a domain; give 0 to 232"),
        (["topic", "list", "--domain", "-1"], "--domain"),
        (["topic", "echo", "x", "--timeout", "0"], "'0' is not a number above 0"),
        (["topic", "echo", "x", "-l", "-5"], "-l"),
        (["topic", "echo", "x", "--qos-reliability", "good"], "invalid choice: 'good'"),
        (["topic", "hz", "x", "--window", "0"], "'0' is not an integer above 0"),
        (["node", "info"], "NODE"),
    ],
)
def test_a_wrong_command_line(arguments, said, capsys):
    assert cli.main(arguments) == 2
    captured = capsys.readouterr()
    assert said in captured.err
    assert re.search(r" \(help: uros[a-z0-9 ]* --help\)\n$", captured.err)
    assert captured.err.count("\n") == 1 and "usage" not in captured.err
    assert captured.out == ""


def test_the_commands_of_the_agent_are_known_one_level_up():
    from uros.tools.agent import command

    assert cli.commands().members["agent"].words == command._VERBS


@pytest.mark.parametrize("kind", [ToolError, MiddlewareError, InterfaceError])
def test_errors_are_one_line(kind, monkeypatch, capsys):
    def fail(args):
        raise kind("it does not work:\n do this")

    monkeypatch.setattr(topic_list, "run", fail)
    assert cli.main(["topic", "list"]) == 1
    assert capsys.readouterr().err == "uros: it does not work: do this\n"


def test_internal_errors_keep_their_traceback(monkeypatch):
    def fail(args):
        raise KeyError("a bug")

    monkeypatch.setattr(topic_list, "run", fail)
    with pytest.raises(KeyError):
        cli.main(["topic", "list"])


def test_interrupted(monkeypatch, capsys):
    def interrupt(args):
        raise KeyboardInterrupt

    monkeypatch.setattr(topic_list, "run", interrupt)
    assert cli.main(["topic", "list"]) == 130
    assert capsys.readouterr().err == ""


PRINTER = (
    "import sys; from uros.tools import cli; from uros.tools.topic import list as topic_list\n"
    "topic_list.run = lambda args: print('much') or 0\n"
    "sys.exit(cli.main(['topic', 'list']))"
)


def print_to(stdout):
    """(exit status, standard error) of a verb that prints."""
    done = subprocess.run(
        [sys.executable, "-c", PRINTER], stdout=stdout, stderr=subprocess.PIPE, text=True
    )
    return done.returncode, done.stderr


def test_a_closed_output():
    read_end, write_end = os.pipe()
    os.close(read_end)
    assert print_to(write_end) == (141, "")
    os.close(write_end)


def test_output_that_cannot_be_written():
    with open("/dev/full", "w") as full:
        status, error = print_to(full)
    assert status == 1
    assert error == "uros: the output cannot be written: No space left on device\n"


def test_a_domain_that_does_not_exist_has_one_status_and_one_wording(monkeypatch, capsys):
    said = "'300' is not a domain; give 0 to 232"
    assert cli.main(["topic", "list", "--domain", "300"]) == 2
    assert said in capsys.readouterr().err
    monkeypatch.setenv("ROS_DOMAIN_ID", "300")
    assert cli.main(["topic", "list"]) == 2
    assert capsys.readouterr().err == f"uros: ROS_DOMAIN_ID: {said}\n"
    monkeypatch.setenv("XRCE_DOMAIN_ID_OVERRIDE", "300")
    assert cli.main(["agent", "udp4", "-p", "0", "-m", "memory", "--domain", "0"]) == 2
    assert capsys.readouterr().err == f"uros: XRCE_DOMAIN_ID_OVERRIDE: {said}\n"


@pytest.mark.parametrize(
    "verb", ["topic list", "node list", "service list", "service find std_srvs/Empty"]
)
def test_an_empty_domain_is_explained(verb, own_domain_id, capsys, monkeypatch):
    agents_here(monkeypatch)
    words = [*verb.split(), "--domain", str(own_domain_id), "--spin-time", "0.1"]
    assert cli.main(words) == 0
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith(f"uros: no other participant was found in domain {own_domain_id}; check")
    assert err.endswith("or run 'uros doctor'\n") and err.count("\n") == 1


def test_services_of_a_type_that_nobody_knows(own_domain_id, capsys, monkeypatch):
    agents_here(monkeypatch)
    words = ["service", "find", "std_srvs/Triger", "--domain", str(own_domain_id)]
    assert cli.main([*words, "--spin-time", "0.1"]) == 0
    assert capsys.readouterr().err.endswith(
        "WARNING: no definition of the type std_srvs/srv/Triger is known; did you mean"
        " 'std_srvs/srv/Trigger'?\n"
    )


def agents_here(monkeypatch, *snapshots):
    """The agents of this machine; a snapshot may be an error."""
    agents = [running_agents.RunningAgent(41 + at, Path("x")) for at in range(len(snapshots))]

    def ask(agent, question):
        if isinstance(snapshots[agent.pid - 41], Exception):
            raise snapshots[agent.pid - 41]
        return snapshots[agent.pid - 41]

    monkeypatch.setattr(running_agents, "find_agents", lambda: agents)
    monkeypatch.setattr(running_agents, "ask", ask)


def test_what_the_agents_of_this_machine_tell_of_an_empty_domain(monkeypatch):
    board = {"nodes": [{"name": "/board", "domain": 7}]}
    here = {"middleware": "auto", "clients": [{"nodes": [{"name": "/b", "domain": 3}]}]}
    agents_here(
        monkeypatch,
        {"middleware": "memory", "clients": [board, *here["clients"]]},
        {"middleware": "auto", "clients": []},
        {"middleware": "auto", "clients": [board, {"nodes": []}]},
        {"middleware": "auto", "clients": [{"nodes": []}]},
        ToolError("it has ended"),
    )
    assert agents_reasons(3) == [
        "the agent 41 runs with -m memory: its boards reach each other, and no ROS 2 node; start it"
        " without -m",
        "the agent 42 has no board: 'uros agent status' shows what it serves",
        "the agent 43 has its boards in domain 7: --domain 7",
    ]
    agents_here(monkeypatch, {"middleware": "auto", "clients": [board]}, here)
    assert agents_reasons(3) == []  # an agent with a board there: other domains explain nothing


@pytest.mark.parametrize("alone", [False, True])
def test_an_unknown_name_is_answered_with_the_domain_of_this_machines_boards(monkeypatch, alone):
    board = {"nodes": [{"name": "/board", "domain": 7}]}
    network = SimpleNamespace(alone=alone, domain=3)
    agents_here(monkeypatch)
    assert "--domain 7" not in remedy(network, "/add", ["/scan"])
    agents_here(
        monkeypatch,
        {"middleware": "auto", "clients": []},
        {"middleware": "auto", "clients": [board]},
    )
    known = [] if alone else ["/scan"]
    text = remedy(network, "/add", known)
    assert text.endswith("; the agent 42 has its boards in domain 7: --domain 7")
    assert ("no other participant" in text) == alone


def test_many_agents_are_not_all_named(own_domain_id, monkeypatch, capsys):
    agents_here(monkeypatch, *[{"middleware": "auto", "clients": []}] * 5)
    cli.main(["topic", "list", "--domain", str(own_domain_id), "--spin-time", "0.1"])
    err = capsys.readouterr().err
    assert err.count("has no board") == 3
    assert err.endswith("uros: and 2 more agents: 'uros agent status' lists them\n")


def test_topics_of_an_agent_without_a_network(own_domain_id, monkeypatch, capsys):
    agents_here(monkeypatch, {"middleware": "memory", "clients": []})
    cli.main(["topic", "list", "--domain", str(own_domain_id), "--spin-time", "0.1"])
    err = capsys.readouterr().err
    assert "no other participant" in err
    assert "the agent 41 runs with -m memory" in err


def test_interfaces_folder_that_does_not_exist(capsys):
    assert cli.main(["topic", "list", "--interfaces", "/no/such"]) == 1
    assert capsys.readouterr().err.startswith("uros: /no/such: no such folder")


def test_the_variable_with_folders_is_checked_by_every_verb(monkeypatch, capsys):
    monkeypatch.setenv("UROS_INTERFACES", "/no/such")
    for verb in (["topic", "list"], ["interface", "list"], ["board", "index", "/no/out"]):
        assert cli.main(verb) == 1
        assert capsys.readouterr().err.startswith("uros: UROS_INTERFACES: /no/such: no such folder")


@pytest.mark.parametrize(
    "arguments, kept",
    [
        (["udp4", "-p", "8888"], ["udp4", "-p", "8888"]),
        (["udp4", "--ros-args", "-r", "__node:=x"], ["udp4"]),
        (["udp4", "--ros-args", "-r", "a:=b", "--", "-v6"], ["udp4", "-v6"]),
        (["--ros-args", "--", "udp4", "--ros-args"], ["udp4"]),
        ([], []),
    ],
)
def test_ros_args(arguments, kept):
    assert cli.without_ros_args(arguments) == kept


@pytest.mark.parametrize("name", ["MicroXRCEAgent", "micro_ros_agent"])
def test_the_aliases_of_the_agent(name, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", [f"/usr/bin/{name}", "--help", "--ros-args", "--log-level"])
    assert cli.agent_main() == 0
    assert f"usage: {name} " in capsys.readouterr().out


@pytest.mark.parametrize("closed", ["0", "1", "2", "012"])
def test_started_without_standard_streams(closed):
    """As a careless daemon does, or ``>&-``: no socket may become standard output."""
    away = " ".join(f"{descriptor}>&-" for descriptor in closed)
    done = subprocess.run(
        f'exec "{sys.executable}" -m uros agent udp4 -p 0 -m memory --stop-at-eof {away}',
        shell=True, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=30,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr
    assert ("server stopped" in done.stdout) == ("1" not in closed)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["udp4", "--qos", f"/a:depth={'9' * 5000}"], "depth is '999"),
        (["serial", "--dev", "hwgrep://["], "hwgrep://[: unterminated character set"),
    ],
)
def test_flags_of_the_agent_without_effect(arguments, said, capsys):
    assert cli.main(["agent", *arguments, "-m", "memory"]) == 1
    printed = capsys.readouterr().err
    assert printed.startswith("uros: ") and said in printed, printed


INTERRUPTED = """
import sys
from importlib.abc import MetaPathFinder

class Interrupt(MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name == {name!r}:
            raise KeyboardInterrupt  # as the handler of SIGINT does

sys.meta_path.insert(0, Interrupt())
sys.argv = ["uros", "agent", "udp4", "-p", "0", "-m", "memory"]
from uros.__main__ import main
sys.exit(main())
"""


@pytest.mark.parametrize(
    "name", ["argparse", "uros.tools.cli", "uros.tools.agent.command", "uros.agent.agent"]
)
def test_ctrl_c_while_modules_load_prints_nothing(name):
    done = subprocess.run(
        [sys.executable, "-S", "-c", f"import sys; sys.path[:] = {sys.path!r}"
         + INTERRUPTED.format(name=name)],
        capture_output=True, text=True,
    )  # fmt: skip
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "")


def test_the_installed_commands_handle_ctrl_c_first():
    text = (Path(__file__).parents[3] / "pyproject.toml").read_text("utf-8")
    scripts = re.search(r"\[project\.scripts\]\n((?:.+\n)+)", text)[1]
    for name, function in re.findall(r'^(\w+) = "(.+)"$', scripts, re.MULTILINE):
        assert function == f"uros.__main__:{'main' if name == 'uros' else 'agent_main'}"
    assert scripts.count("\n") == 3
