"""The files in deploy/ for services and packages name commands, options and files that exist."""

import argparse
import configparser
import importlib.util
import io
import plistlib
import re
import shutil
import subprocess
import tarfile
from pathlib import Path
from xml.etree import ElementTree

import pytest
from support.paths import ROOT

from uros.tools.agent import command as agent
from uros.tools.agent.config.file import Config

DEPLOY = ROOT / "deploy"
SYSTEM = DEPLOY / "systemd" / "uros-agent.service"
INSTANCE = DEPLOY / "systemd" / "uros-agent@.service"
USER = DEPLOY / "systemd" / "user" / "uros-agent.service"
UNITS = [SYSTEM, INSTANCE, USER]
RULES = DEPLOY / "udev" / "70-uros.rules"
# What each unit must restrict; `systemd-analyze security` judges the whole.
HARDENED = {
    SYSTEM: {"CapabilityBoundingSet": "", "ProtectSystem": "strict", "PrivateTmp": "yes",
             "ProtectHome": "yes", "DevicePolicy": "closed"},
    USER: {},
}  # fmt: skip
HARDENED[INSTANCE] = HARDENED[SYSTEM]
COMMON = {"NoNewPrivileges": "yes", "MemoryDenyWriteExecute": "yes", "UMask": "0077",
          "RuntimeDirectory": "uros", "StateDirectory": "uros", "Type": "exec"}  # fmt: skip


def unit(path):
    parser = configparser.RawConfigParser(strict=False, comment_prefixes="#")
    parser.optionxform = str
    parser.read_string(path.read_text("utf-8"))
    return {name: dict(parser.items(name)) for name in parser.sections()}


def accepts(words):
    """Whether ``uros agent`` takes these words; nothing is started."""
    parser = argparse.ArgumentParser(exit_on_error=False)
    agent.add_arguments(parser)
    try:
        parser.parse_args(words)
    except SystemExit:
        return False
    return True


@pytest.mark.parametrize("path", UNITS, ids=str)
def test_the_units_name_commands_and_options_that_there_are(path):
    words = unit(path)["Service"]["ExecStart"].split()
    assert words[:2] == ["uros", "agent"] and accepts(words[2:])
    assert not accepts([*words[2:], "--no-such-option"])
    assert unit(path)["Service"]["ExecReload"] == "kill -HUP $MAINPID"


@pytest.mark.parametrize("path", UNITS, ids=str)
def test_the_units_are_hardened_and_restart(path):
    service = unit(path)["Service"]
    wanted = {**COMMON, **HARDENED[path], "Restart": "on-failure"}
    assert {key: service.get(key) for key in wanted} == wanted
    families = set(service["RestrictAddressFamilies"].split())
    assert families >= {"AF_INET", "AF_INET6", "AF_UNIX", "AF_CAN", "AF_BLUETOOTH"}


def test_an_instance_differs_in_its_name_and_its_configuration_alone():
    def settings(path):
        lines = path.read_text("utf-8").splitlines()
        return [line for line in lines if not line.startswith("#")]

    pairs = [
        pair
        for pair in zip(settings(SYSTEM), settings(INSTANCE), strict=True)
        if pair[0] != pair[1]
    ]
    assert [pair[0].partition("=")[0] for pair in pairs] == [
        "Description", "ExecStart", "SyslogIdentifier"
    ]  # fmt: skip
    assert "/etc/uros/%i.toml" in pairs[1][1] and "/etc/uros/agent.toml" in pairs[1][0]


def test_the_user_of_the_units_is_made_and_may_use_serial_lines():
    lines = (DEPLOY / "systemd" / "uros.sysusers").read_text("utf-8").splitlines()
    made = [line.split()[:2] for line in lines if line and not line.startswith("#")]
    service = unit(SYSTEM)["Service"]
    assert ["u", service["User"]] in made
    assert f"m {service['User']} {service['SupplementaryGroups']}" in lines


def test_the_configuration_of_the_package_is_sound():
    config = Config(str(DEPLOY / "agent.toml"), agent._GROUPS)
    assert not config.problems and config.transports
    state = Path(config.options["state"])
    assert state.parent == Path("/var/lib") / unit(SYSTEM)["Service"]["StateDirectory"]


def test_the_udev_rules_are_of_known_keys_and_reach_their_labels():
    lines = [line for line in RULES.read_text("utf-8").splitlines() if line and line[0] != "#"]
    keys = set()
    for line in lines:
        for part in line.split(", "):
            match = re.fullmatch(r'([A-Z_]+(?:\{\w+\})?)(==|!=|\+=|=)"([^"]*)"', part)
            assert match, part
            keys.add(match[1])
    assert {"GROUP", "MODE", "TAG", "SYMLINK"} <= keys
    text = "\n".join(lines)
    assert set(re.findall(r'GOTO="(\w+)"', text)) == set(re.findall(r'LABEL="(\w+)"', text))
    assert int(RULES.name[:2]) < 73  # where systemd grants uaccess
    assert not re.search(r'"[0-9a-f]*[A-F]', text), "udev compares numbers in lower case"


def test_the_udev_rules_know_the_board_of_the_host_page():
    page = (ROOT / "docs" / "host-setup.md").read_text("utf-8")
    (vendor,) = set(re.findall(r'idVendor\}=="(\w+)"', page))
    assert f'ATTRS{{idVendor}}=="{vendor}"' in RULES.read_text("utf-8")


def test_the_services_of_macos_and_windows_start_the_agent():
    plist = plistlib.loads((DEPLOY / "macos" / "uros.agent.plist").read_bytes())
    words = plist["ProgramArguments"]
    assert words[0].endswith("/uros") and words[1] == "agent" and accepts(words[2:])
    assert plist["Label"] == "uros.agent" and plist["KeepAlive"] == {"SuccessfulExit": False}
    service = ElementTree.parse(DEPLOY / "windows" / "uros-agent.xml").getroot()
    assert service.findtext("executable").endswith(r"\uros.exe")
    words = service.findtext("arguments").split()
    assert words[0] == "agent" and accepts(words[1:])
    assert service.find("onfailure").get("action") == "restart"


# --- the Debian package -----------------------------------------------------------------------


@pytest.fixture(scope="module")
def deb(tmp_path_factory):
    """The built package: its control files and its paths with their modes."""
    if not shutil.which("dpkg-deb"):
        pytest.skip("not on this platform: there is no dpkg-deb")
    folder = tmp_path_factory.mktemp("deb")
    spec = importlib.util.spec_from_file_location("deb", ROOT / "scripts" / "deb.py")
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(ROOT / "scripts"))
        patch.setenv("SOURCE_DATE_EPOCH", "1700000000")
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        package = module.build(folder)
        again = module.build(tmp_path_factory.mktemp("again"))
    assert package.read_bytes() == again.read_bytes(), "the build is not reproducible"
    parts = {}
    for option in ("--ctrl-tarfile", "--fsys-tarfile"):
        raw = subprocess.run(["dpkg-deb", option, package], capture_output=True, check=True).stdout
        parts[option] = tarfile.open(fileobj=io.BytesIO(raw))
    return parts["--ctrl-tarfile"], parts["--fsys-tarfile"]


@pytest.mark.long
@pytest.mark.slow
def test_the_debian_package_has_commands_units_rules_and_configuration(deb):
    control, files = deb
    members = {member.name.lstrip("./"): member for member in files.getmembers()}
    for name in (
        "usr/bin/uros", "usr/bin/MicroXRCEAgent", "usr/bin/micro_ros_agent",
        "usr/lib/python3/dist-packages/uros/tools/cli.py",
        "usr/lib/systemd/system/uros-agent.service", "usr/lib/systemd/system/uros-agent@.service",
        "usr/lib/systemd/user/uros-agent.service", "usr/lib/udev/rules.d/70-uros.rules",
        "usr/lib/sysusers.d/uros.conf", "etc/uros/agent.toml", "usr/share/doc/uros/copyright",
        "usr/share/uros/ament/lib/micro_ros_agent/micro_ros_agent",
    ):  # fmt: skip
        assert name in members, name
    assert members["usr/bin/uros"].mode & 0o777 == 0o755
    assert not [name for name in members if "__pycache__" in name or name.startswith("usr/local")]
    assert {member.uid for member in members.values()} == {0}
    assert {member.mode & 0o022 for member in members.values()} == {0}
    setup = files.extractfile("./usr/share/uros/ament/setup.bash").read().decode()
    assert "AMENT_PREFIX_PATH=/usr/share/uros/ament$" in setup
    program = files.extractfile("./usr/share/uros/ament/lib/micro_ros_agent/micro_ros_agent")
    assert b"exec /usr/bin/uros agent" in program.read()
    text = control.extractfile("./control").read().decode()
    assert "Architecture: all\n" in text and "python3-yaml" in text and "cyclone" not in text
    assert control.extractfile("./conffiles").read() == b"/etc/uros/agent.toml\n"


@pytest.mark.long
@pytest.mark.slow
def test_the_scripts_of_the_debian_package_are_sound_and_purge_takes_everything(deb):
    control, _ = deb
    for name in ("postinst", "prerm", "postrm"):
        assert control.getmember(f"./{name}").mode & 0o777 == 0o755
        text = control.extractfile(f"./{name}").read()
        assert subprocess.run(["sh", "-n"], input=text).returncode == 0
        assert text.startswith(b"#!/bin/sh\n") and b"\nset -e\n" in text
    purge = control.extractfile("./postrm").read().decode()
    service = unit(SYSTEM)["Service"]
    for folder in ("/etc/uros", f"/var/lib/{service['StateDirectory']}", "/run/uros"):
        assert folder in purge
    assert f"userdel {service['User']}" in purge


def test_versions_of_debian_sort_as_those_of_python(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "scripts"))
    spec = importlib.util.spec_from_file_location("deb", ROOT / "scripts" / "deb.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    versions = [
        module.version_of(Path(f"uros-{version}-py3-none-any.whl"))
        for version in ("1.2.0.dev1", "1.2.0a1", "1.2.0rc1", "1.2.0", "1.2.0.post1", "1.10.0")
    ]
    assert versions[0] == "1.2.0~dev1-1" and versions[3] == "1.2.0-1"
    if shutil.which("dpkg"):
        for older, newer in zip(versions[1:], versions[2:], strict=False):
            command = ["dpkg", "--compare-versions", older, "lt", newer]
            assert subprocess.run(command).returncode == 0, (older, newer)
