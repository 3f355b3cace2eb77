"""``uros completion``: the printed function in a real bash, at a terminal."""

import os
import select
import shutil
import subprocess
import sys
import time

import pytest

from uros.tools import cli
from uros.tools.completion.shells import FUNCTIONS


class Bash:
    """An interactive bash in a pseudo-terminal."""

    def __init__(self, folder):
        command = folder / "uros"
        command.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m uros "$@"\n')
        command.chmod(0o755)
        self.master, slave = os.openpty()
        environment = {
            **os.environ, "PATH": f"{folder}:{os.environ['PATH']}", "PS1": "$ ", "TERM": "dumb",
            "INPUTRC": "/dev/null", "HISTFILE": "",
        }  # fmt: skip
        self.process = subprocess.Popen(
            [shutil.which("bash"), "--norc", "--noprofile", "-i"], stdin=slave, stdout=slave,
            stderr=slave, env=environment, start_new_session=True,
        )  # fmt: skip
        os.close(slave)
        self.seen = ""

    def type(self, text, until, seconds=100):
        """Type a text; wait until the terminal shows another one, and return all of it since."""
        start = len(self.seen)
        os.write(self.master, text.encode())
        end = time.monotonic() + seconds
        while until not in self.seen[start:]:
            left = end - time.monotonic()
            assert left > 0 and select.select([self.master], [], [], left)[0], self.seen
            self.seen += os.read(self.master, 4096).decode()
        return self.seen[start:]

    def close(self):
        self.process.kill()
        self.process.wait()
        os.close(self.master)


@pytest.fixture
def bash(tmp_path):
    shell = Bash(tmp_path)
    yield shell
    shell.close()


def test_tab_completes_in_bash(bash):
    bash.type('eval "$(uros completion bash)" && echo rea""dy\n', "ready")
    bash.type("uros topi\t", "uros topic ")
    bash.type("ec\t", "echo ")
    bash.type("--qos-reliability=rel\t", "=reliable ")
    bash.type("--qos-dur\t\t", "--qos-durability ")
    listed = bash.type("\x15uros agent udp\t\t", "udp6")
    assert "udp4" in listed


def test_tab_completes_values_in_bash(bash, tmp_path):
    (tmp_path / "a_file").touch()
    bash.type(f'cd {tmp_path}; eval "$(uros completion bash)" && echo rea""dy\n', "ready")
    bash.type("uros topic pub /x std_msgs/msg/String \t", "\"{data: ''}\" ")
    bash.type("\x15uros topic pub /x std_msgs/msg/Int32 '{da\t", "{data: 0}' ")
    assert "a_file" not in bash.type("\x15uros topic pub /x std_msgs/msg/Int32 a\t", "\x07")
    bash.type("\x15uros trace a\t", "a_file")


def test_the_shell_is_that_of_the_user(monkeypatch, capsys):
    monkeypatch.setenv("SHELL", "/usr/bin/fish")
    assert cli.main(["completion"]) == 0
    assert capsys.readouterr().out == FUNCTIONS["fish"]
    assert cli.main(["completion", "csh"]) == 2
    assert "'csh'; name one: uros completion bash | zsh | fish" in capsys.readouterr().err
    monkeypatch.delenv("SHELL")
    assert cli.main(["completion"]) == 2
    assert "SHELL is not set" in capsys.readouterr().err
