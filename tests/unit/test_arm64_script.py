"""scripts/arm64.py refuses by name what it cannot do; what it does takes `make test-arm64`."""

import importlib.util
import sys

import pytest
from support.paths import ROOT

SCRIPTS = ROOT / "scripts"


@pytest.fixture
def arm64(monkeypatch):
    monkeypatch.syspath_prepend(str(SCRIPTS))
    spec = importlib.util.spec_from_file_location("arm64", SCRIPTS / "arm64.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def machine(arm64, monkeypatch, tmp_path):
    """An x86_64 machine with root and all packages, and its binfmt_misc."""
    monkeypatch.setattr(arm64.platform, "machine", lambda: "x86_64")
    monkeypatch.setattr(arm64.os, "geteuid", lambda: 0)
    monkeypatch.setattr(arm64.shutil, "which", lambda name: f"/usr/bin/{name}")
    monkeypatch.setattr(arm64.env, "succeeds", lambda *command: False)
    monkeypatch.setattr(arm64, "BINFMT", tmp_path)
    return tmp_path


def entry(arm64, folder, first="enabled", flags="F"):
    text = f"{first}\ninterpreter /usr/bin/qemu\nflags: {flags}\noffset 0\nmagic {arm64._MAGIC}\n"
    (folder / "qemu-aarch64").write_text(text)


def test_without_root_it_refuses_by_name(arm64, machine, monkeypatch, capsys):
    monkeypatch.setattr(arm64.os, "geteuid", lambda: 1000)
    monkeypatch.setattr(sys, "argv", ["arm64.py"])
    with pytest.raises(SystemExit) as exit:
        arm64.main()
    assert "make test-arm64 needs root" in exit.value.code and "sudo" in exit.value.code


def test_without_binfmt_misc_it_refuses_by_name(arm64, machine, monkeypatch):
    monkeypatch.setattr(arm64, "BINFMT", machine / "missing")
    with pytest.raises(arm64.env.Unavailable, match="needs binfmt_misc"):
        arm64.check()


def test_packages_that_cannot_be_installed_are_named(arm64, machine, monkeypatch):
    monkeypatch.setattr(arm64.shutil, "which", lambda name: None)
    monkeypatch.setattr(arm64.env, "apt_install", lambda *packages: False)
    with pytest.raises(arm64.env.Unavailable, match="no debootstrap and no qemu-user-static"):
        arm64.check()


@pytest.mark.parametrize(
    ("first", "flags", "is_used"),
    [("enabled", "F", True), ("enabled", "OPF", True), ("enabled", "OC", False),
     ("disabled", "F", False)],
)  # fmt: skip
def test_an_entry_of_binfmt_misc_is_used_if_it_reaches_into_a_chroot(
    arm64, machine, first, flags, is_used
):
    entry(arm64, machine, first, flags)
    (machine / "register").write_text("")
    arm64.check()
    registered = (machine / "register").read_text()
    assert registered == "" if is_used else registered.endswith(":/usr/bin/qemu-aarch64-static:F")


def test_on_arm64_nothing_is_emulated(arm64, machine, monkeypatch):
    monkeypatch.setattr(arm64.platform, "machine", lambda: "aarch64")
    monkeypatch.setattr(arm64, "BINFMT", machine / "missing")
    arm64.check()


def test_the_tests_that_are_left_out_exist(arm64):
    missing = []
    for place in (*arm64.NOT_EMULATED, *arm64.NOT_INSTALLED):
        path, _, name = place.partition("::")
        file = ROOT / path
        if not file.is_file() or f"def {name.partition('[')[0]}" not in file.read_text("utf-8"):
            missing.append(place)
    assert not missing


def test_settings_of_this_machine_that_mean_nothing_there_stay_here(
    arm64, machine, monkeypatch, tmp_path
):
    debian = tmp_path / "debian"
    (debian / "etc" / "ssl" / "certs").mkdir(parents=True)
    bundle = tmp_path / "bundle.crt"
    bundle.write_text("certificates")
    monkeypatch.setattr(arm64, "DEBIAN", debian)
    monkeypatch.setenv("SSL_CERT_FILE", str(bundle))
    monkeypatch.setenv("PIP_FIND_LINKS", "/opt/wheels")
    monkeypatch.setenv("PIP_DEFAULT_TIMEOUT", "7")
    found = arm64.settings()
    assert (debian / "etc" / "ssl" / "certs" / "of-the-host.crt").read_text() == "certificates"
    assert found["PIP_CERT"] == found["SSL_CERT_FILE"] == "/etc/ssl/certs/of-the-host.crt"
    assert found["PIP_DEFAULT_TIMEOUT"] == "7" and "PIP_FIND_LINKS" not in found
    assert not {"PYTHONPATH", "ROS_DOMAIN_ID"} & found.keys()
