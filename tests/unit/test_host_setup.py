"""Files, extras and commands in docs/host-setup.md and deploy/ exist and are accepted."""

import argparse
import json
import re
import shlex
import subprocess
from pathlib import Path

import pytest

from uros.middleware.base import MAX_DOMAIN
from uros.tools.agent import command as agent
from uros.tools.agent.options.transports import TRANSPORTS

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "host-setup.md").read_text("utf-8")
CONTAINERFILE = (ROOT / "deploy" / "Containerfile").read_text("utf-8")
COMPOSE = (ROOT / "deploy" / "compose.yaml").read_text("utf-8")
PROJECT = (ROOT / "pyproject.toml").read_text("utf-8")


def accepted(words):
    """Whether ``uros agent`` accepts these words; parses them without starting an agent."""
    parser = argparse.ArgumentParser()
    agent.add_arguments(parser)
    (transports,) = [
        action for action in parser._actions if isinstance(action, argparse._SubParsersAction)
    ]
    rest = words
    while rest:
        transport, *rest = rest
        known, rest = transports.choices[transport].parse_known_args(rest)
        if rest and rest[0] not in transports.choices:
            return False
    return True


def copied():
    """Return the names that the Containerfile copies into the image."""
    copies = []
    for names in re.findall(r"^COPY (?!--from)(.+)$", CONTAINERFILE, re.M):
        copies += names.split()[:-1]
    return copies


def test_the_container_gets_what_the_package_is_built_from():
    names = copied()
    assert not [name for name in names if not (ROOT / name).exists()]
    (readme,) = re.findall(r'^readme = "(.+)"', PROJECT, re.M)
    (licence,) = re.findall(r'^license-files = \["(.+)"\]', PROJECT, re.M)
    (forced,) = re.findall(r'force-include\]\n"(\w+)" = ', PROJECT)
    entry = "deploy/entrypoint.sh"
    assert {"pyproject.toml", "src", readme, licence, forced, entry} == set(names)


@pytest.mark.parametrize("name", ["Containerfile.containerignore", "Containerfile.dockerignore"])
def test_no_copied_file_is_ignored(name):
    lines = (ROOT / "deploy" / name).read_text("utf-8").splitlines()
    assert [line[1:] for line in lines if line.startswith("!")] == copied()


def test_the_container_s_extras_and_python_are_the_project_s():
    (extras,) = re.findall(r"'\.\[(.+?)\]'", CONTAINERFILE)
    for extra in extras.split(","):
        assert re.search(rf"^{extra} = \[", PROJECT, re.M), extra
    (version,) = re.findall(r"^ARG BASE=\S+/python:3\.(\d+)-slim$", CONTAINERFILE, re.M)
    (oldest,) = re.findall(r'^requires-python = ">=3\.(\d+)"', PROJECT, re.M)
    (newest,) = re.findall(r"cyclonedds~=.*python_version < '3\.(\d+)'", PROJECT)
    assert int(oldest) <= int(version) < int(newest)


@pytest.fixture
def container(tmp_path):
    """Return a function that gives the command which the container's entry point starts."""
    stub = tmp_path / "uros"
    stub.write_text('#!/bin/sh\necho "$@"\n')
    stub.chmod(0o755)

    def command(*words):
        environment = {"PATH": f"{tmp_path}:/usr/bin:/bin"}
        return subprocess.run(
            [ROOT / "deploy" / "entrypoint.sh", *words],
            env=environment, capture_output=True, text=True, check=True,
        ).stdout.split()  # fmt: skip

    return command


def test_the_command_of_the_container_is_accepted(container):
    assert 'ENTRYPOINT ["uros-entrypoint"]' in CONTAINERFILE
    (default,) = re.findall(r"^CMD (.+)$", CONTAINERFILE, re.M)
    words = container(*re.findall(r'"(.*?)"', default))
    assert words[0] == "agent" and accepted(words[1:])


@pytest.mark.parametrize("transport", TRANSPORTS)
def test_the_container_takes_the_arguments_of_the_image_of_micro_ros(container, transport):
    assert container(transport, "--port", "8888", "-v6") == [
        "agent", transport, "--port", "8888", "-v6"
    ]  # fmt: skip


def test_the_container_takes_the_other_commands(container):
    assert container("topic", "list", "-t") == ["topic", "list", "-t"]
    assert container("--version") == ["--version"]
    assert container("agent", "status") == ["agent", "status"]
    assert container("-h") == ["agent", "-h"]
    assert container() == []


def test_the_health_check_of_the_container_is_a_command_for_a_user_who_is_not_root():
    (check,) = re.findall(r"^HEALTHCHECK .*CMD (\[.+\])$", CONTAINERFILE, re.M)
    assert json.loads(check) == ["uros", "agent", "status"]
    (user,) = re.findall(r"^USER (.+)$", CONTAINERFILE, re.M)
    assert user == "uros" and f"--uid 1000 {user}" in CONTAINERFILE


def test_the_command_of_compose_is_accepted():
    (command,) = re.findall(r"^    command: >-\n((?:      .+\n)+)", COMPOSE, re.M)
    text = re.sub(r"\$\{\w+:-(.*?)\}", r"\1", command)
    words = text.split()
    assert words[0] == "agent" and accepted(words[1:])
    assert "dockerfile: deploy/Containerfile" in COMPOSE


def test_the_agent_commands_on_the_page_are_accepted():
    commands = re.findall(r"^(?:uros |.*? uros )agent ([^\n#]+)", "\n".join(blocks()), re.M)
    assert len(commands) >= 4
    for command in commands:
        assert accepted(shlex.split(command)), command


def blocks():
    text = PAGE.replace("\\\n", " ")
    return re.findall(r"^```\n(.*?)^```$", text, re.M | re.S)


def test_no_container_is_privileged():
    text = "\n".join(blocks()) + COMPOSE
    assert "--privileged" not in text and "privileged: true" not in text
    runs = [
        line for block in blocks() for line in block.splitlines() if re.match(r"\w+ run ", line)
    ]
    assert len(runs) == 2
    for run in runs:
        assert "--network=host" in run and "--device /dev/ttyACM0" in run and "--group-add" in run


def test_the_ports_of_dds():
    """RTPS 9.6.2: 7400 + 250 a domain; safe domains end below Linux's ephemeral ports."""
    first, last = map(int, re.search(r"UDP ports (\d+) to (\d+) for domain 0", PAGE).groups())
    assert (first, last) == (7400, 7400 + 250 - 1)
    (safe,) = re.findall(r"the same number, 0 to (\d+) to be safe", PAGE)
    assert 7400 + 250 * int(safe) < 32768 < 7400 + 250 * (int(safe) + 1)
    assert int(safe) <= MAX_DOMAIN


def test_the_udev_rule_is_for_the_board_of_the_page():
    main = (ROOT / "firmware" / "ra6m5_sensor_node" / "main.py").read_text("utf-8")
    vendor, product = re.search(r'idVendor\}=="(\w+)", ATTRS\{idProduct\}=="(\w+)"', PAGE).groups()
    assert re.search(rf"0x{vendor}, 0x{product}", main, re.I)


def test_untested_platforms_are_marked():
    for name in ("WSL 2", "macOS", "Windows"):
        (section,) = re.findall(rf"^## {name}\n\n(.*?)(?=^## |\Z)", PAGE, re.M | re.S)
        assert section.startswith("Not tested.")
