"""``uros agent tcp4 --tls-…``: its options, and the commands of the page about it."""

import argparse
import re
import subprocess

import pytest
from support.agent import RunningAgent, serving
from support.paths import ROOT
from unit.agent.transports.test_process import refused
from unit.transport.test_tcp import QUICK, until

from uros.agent.transports.tcp import TcpServer
from uros.agent.transports.tls import TlsServer, tls_server
from uros.client import AGENT_CONNECTED, Node
from uros.tools.agent.options.transports import TRANSPORTS, make
from uros.transport.tls import TlsTransport

PAGE = ROOT / "docs" / "security.md"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """With what the commands of the page make."""
    folder = tmp_path_factory.mktemp("page")
    (commands,) = re.findall(r"^```sh\n(.+?)^```$", PAGE.read_text("utf-8"), re.M | re.S)
    commands = commands.replace("IP:192.168.1.20", "IP:127.0.0.1")
    subprocess.run(["sh", "-e", "-c", commands], cwd=folder, check=True, capture_output=True)
    return folder


def parsed(name, *args):
    parser = argparse.ArgumentParser()
    TRANSPORTS[name].add_options(parser)
    return argparse.Namespace(transport=name, **vars(parser.parse_args(args)))


@pytest.mark.parametrize("name", ["tcp4", "tcp6"])
def test_options_of_tcp(folder, name):
    cert, key, ca = (str(folder / name) for name in ("agent.pem", "agent.key", "ca.pem"))
    (plain,) = make(parsed(name))
    assert type(plain) is TcpServer
    for more in ([], ["--tls-ca", ca]):
        (made,) = make(parsed(name, "-p", "0", "--tls-cert", cert, "--tls-key", key, *more))
        assert type(made) is TlsServer and made.name == f"TLSv{name[3]}Agent"


@pytest.mark.parametrize("name", ["udp4", "serial", "canfd"])
def test_other_transports_have_no_tls_options(name):
    parser = argparse.ArgumentParser()
    TRANSPORTS[name].add_options(parser)
    assert "--tls" not in parser.format_help()


def test_invalid_certificates_end_the_agent_with_a_clear_error(folder):
    cert, key = folder / "agent.pem", folder / "agent.key"
    assert refused("tcp4", "-p", 0, "-m", "memory", "--tls-cert", cert) == (
        1, "uros: --tls-key is missing: TLS needs --tls-cert FILE and --tls-key FILE;"
        " docs/security.md has the commands that make them\n",
    )  # fmt: skip
    status, said = refused(
        "tcp4", "-p", 0, "-m", "memory", "--tls-cert", cert, "--tls-key", folder / "left.key"
    )
    assert status == 1 and "does not belong to the certificate" in said
    status, said = refused("udp4", "-p", 0, "--tls-cert", cert, "--tls-key", key)
    assert status == 2 and "unrecognized arguments: --tls-cert" in said


def test_certificates_of_the_pages_commands_work(folder):
    """Agent and board as the page has them; a board's certificate is none for an agent."""
    cert, key, ca = (str(folder / name) for name in ("agent.pem", "agent.key", "ca.pem"))
    board = {name: str(folder / f"left.{end}") for name, end in (("cert", "pem"), ("key", "key"))}
    with serving(RunningAgent(tls_server(0, "127.0.0.1", cert, key, ca), "memory", 0, 4)) as agent:
        for name in ("127.0.0.1", "robot.local"):
            transport = TlsTransport("127.0.0.1", agent.transport.port, ca=ca, name=name, **board)
            node = Node("left", transport, key=1, **QUICK)
            until(node, lambda node=node: node.state == AGENT_CONNECTED)
            node.destroy_node()
        assert "(CN=left)" in agent.said.getvalue()
    false = tls_server(0, "127.0.0.1", board["cert"], board["key"], None)
    with serving(RunningAgent(false, "memory", 0, 4)) as agent:
        transport = TlsTransport("127.0.0.1", agent.transport.port, ca=ca, **board)
        node = Node("left", transport, key=1, **QUICK)
        until(node, lambda: node.connection.reason)
        assert "CERTIFICATE_VERIFY_FAILED" in node.connection.reason
        transport.close()
