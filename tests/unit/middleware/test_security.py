"""SROS 2 is requested but not available: nothing is sent unprotected without a warning."""

import logging
import os
import subprocess
import sys

import pytest

from uros.host.network import Network
from uros.middleware import NAMES, open_middleware
from uros.middleware.base import MiddlewareError

NETWORKS = sorted(NAMES.keys() - {"memory", "ced"})


def demand(monkeypatch, enable, strategy=None):
    for name, value in (("ROS_SECURITY_ENABLE", enable), ("ROS_SECURITY_STRATEGY", strategy)):
        if value is None:
            monkeypatch.delenv(name, raising=False)
        else:
            monkeypatch.setenv(name, value)


@pytest.mark.parametrize("name", NETWORKS)
@pytest.mark.parametrize("enable", ["true", "True", " TRUE ", "1"])
def test_enforce_is_refused(monkeypatch, name, enable):
    demand(monkeypatch, enable, "Enforce")
    with pytest.raises(MiddlewareError) as caught:
        open_middleware(name)
    message = str(caught.value)
    assert "ROS_SECURITY_STRATEGY is Enforce, but uros has no DDS Security (SROS 2)" in message
    assert "docs/security.md" in message and "unset ROS_SECURITY_ENABLE" in message


def test_a_middleware_within_the_process_needs_no_security(monkeypatch, caplog):
    demand(monkeypatch, "true", "Enforce")
    open_middleware("memory").close()
    assert caplog.text == ""


@pytest.mark.parametrize("strategy", [None, "", "Permissive"])
def test_permissive_causes_a_warning(monkeypatch, caplog, strategy):
    demand(monkeypatch, "true", strategy)
    with caplog.at_level(logging.WARNING, "uros"):
        open_middleware("rtps").close()
    assert "ROS_SECURITY_ENABLE is true, but uros has no DDS Security" in caplog.text


@pytest.mark.parametrize(
    ("enable", "strategy"), [(None, "Enforce"), ("", "Enforce"), ("false", "Enforce"), ("0", None)]
)
def test_without_a_request_there_is_no_warning(monkeypatch, caplog, enable, strategy):
    demand(monkeypatch, enable, strategy)
    open_middleware("rtps").close()
    assert caplog.text == ""


def test_programs_on_a_host_are_refused_too(monkeypatch):
    import uros

    demand(monkeypatch, "true", "Enforce")
    for join in (lambda: uros.Node("node"), lambda: Network(0)):
        with pytest.raises(MiddlewareError, match="no DDS Security"):
            join()


@pytest.mark.parametrize("command", [["agent", "udp4", "-p", "0"], ["topic", "list"]])
def test_commands_end_with_a_clear_text(command):
    env = {**os.environ, "ROS_SECURITY_ENABLE": "true", "ROS_SECURITY_STRATEGY": "Enforce"}
    done = subprocess.run(
        [sys.executable, "-m", "uros", *command], env=env, capture_output=True, text=True,
        timeout=30,
    )  # fmt: skip
    assert done.returncode == 1
    assert done.stderr.startswith("uros: ROS_SECURITY_ENABLE is true and"), done.stderr
    assert "Traceback" not in done.stderr


def test_a_warning_is_one_plain_line():
    program = "from uros.middleware import open_middleware; open_middleware('rtps').close()"
    done = subprocess.run(
        [sys.executable, "-c", program], env={**os.environ, "ROS_SECURITY_ENABLE": "true"},
        capture_output=True, text=True, timeout=30,
    )  # fmt: skip
    assert done.returncode == 0
    assert done.stderr.startswith("uros: ROS_SECURITY_ENABLE is true, but uros has no DDS")
    assert done.stderr.count("\n") == 1
