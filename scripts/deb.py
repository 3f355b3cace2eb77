"""Builds a Debian package of uros: ``make deb``.

    deb.py [--output FOLDER]      (dist if not given)

The package has the wheel's files for Debian's own python3, the units of systemd, the udev rule and
a configuration of the agent. It depends on python3 and python3-yaml alone, so that one package
serves every architecture. It needs dpkg-deb. SOURCE_DATE_EPOCH makes it reproducible, and is that
of the last commit if it is not set; DEBFULLNAME and DEBEMAIL name its maintainer.

Installing starts no agent: a port that opens by itself would surprise who wants only the tools.
"""

import argparse
import gzip
import os
import shutil
import subprocess
import sys
import tempfile
import zipfile
from email.utils import formatdate
from pathlib import Path

import env

DEPLOY = env.ROOT / "deploy"
DOCS = env.ROOT / "docs"
PACKAGES = Path("usr/lib/python3/dist-packages")
AMENT = Path("usr/share/uros/ament")
COMMANDS = {
    "uros": "main",
    "MicroXRCEAgent": "agent_main",
    "micro_ros_agent": "agent_main",
}
FILES = {
    "usr/lib/systemd/system/uros-agent.service": DEPLOY / "systemd" / "uros-agent.service",
    "usr/lib/systemd/system/uros-agent@.service": DEPLOY / "systemd" / "uros-agent@.service",
    "usr/lib/systemd/user/uros-agent.service": DEPLOY / "systemd" / "user" / "uros-agent.service",
    "usr/lib/sysusers.d/uros.conf": DEPLOY / "systemd" / "uros.sysusers",
    "usr/lib/udev/rules.d/70-uros.rules": DEPLOY / "udev" / "70-uros.rules",
    "etc/uros/agent.toml": DEPLOY / "agent.toml",
    "usr/share/doc/uros/copyright": DEPLOY / "debian" / "copyright",
}
SCRIPTS = ("postinst", "prerm", "postrm")
_COMMAND = """\
#!/usr/bin/python3
import sys

from uros.tools.cli import {function}

sys.exit({function}())
"""
_CHANGELOG = """\
uros ({version}) unstable; urgency=medium

  * See changelog.gz beside this file.

 -- {maintainer}  {date}
"""
_CONTROL = """\
Package: uros
Version: {version}
Section: science
Priority: optional
Architecture: all
Maintainer: {maintainer}
Installed-Size: {size}
Depends: python3 (>= 3.10), python3-yaml, python3 (>= 3.11) | python3-tomli
Recommends: python3-serial
Suggests: python3-prometheus-client, python3-pil, nodejs
Description: micro-ROS in Python: the agent and the tools
 The agent connects micro-ROS boards to a ROS 2 network, over UDP, TCP, TLS,
 serial lines, CAN FD and Bluetooth. The tools list, print and publish topics,
 call services, deploy programs to boards and find faults, without an
 installation of ROS.
 .
 The agent runs as a service of systemd: systemctl enable --now uros-agent.
"""


def maintainer() -> str:
    """Who builds the package, by the variables that Debian's own tools read."""
    return (
        f"{os.environ.get('DEBFULLNAME', 'uros')} <{os.environ.get('DEBEMAIL', 'uros@localhost')}>"
    )


def version_of(wheel: Path) -> str:
    """The version of the package for the wheel's: 1.2.0rc1 is older than 1.2.0, so 1.2.0~rc1-1."""
    version = wheel.name.split("-")[1]
    for word in ("a", "b", "rc", ".dev"):
        version = version.replace(word, "~" + word.lstrip("."))
    return version + "-1"


def build_wheel(folder: Path) -> Path:
    code = "import sys; from hatchling.build import build_wheel; print(build_wheel(sys.argv[1]))"
    done = subprocess.run(
        [sys.executable, "-c", code, str(folder)],
        cwd=env.ROOT, stdout=subprocess.PIPE, text=True, check=True,
    )  # fmt: skip
    return folder / done.stdout.split()[-1]


def lay_out(root: Path, wheel: Path) -> None:
    """Put all files of the package below ``root``."""
    packages = root / PACKAGES
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(packages)
    for info in packages.glob("uros-*.dist-info"):
        # pip shall neither take the package for its own nor list files that dpkg removes.
        (info / "RECORD").unlink()
        (info / "INSTALLER").write_text("dpkg\n")
        shutil.rmtree(info / "licenses")
    for name, function in COMMANDS.items():
        path = root / "usr" / "bin" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(_COMMAND.format(function=function))
        path.chmod(0o755)
    for name, source in FILES.items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(source, path)
    doc = root / "usr" / "share" / "doc" / "uros"
    for page in sorted(DOCS.glob("*.md")):
        shutil.copyfile(page, doc / page.name)
    shutil.copyfile(env.ROOT / "README.md", doc / "README.md")
    changes = (env.ROOT / "CHANGELOG.md").read_bytes()
    (doc / "changelog.gz").write_bytes(gzip.compress(changes, 9, mtime=0))
    entry = _CHANGELOG.format(
        version=version_of(wheel), maintainer=maintainer(),
        date=formatdate(int(os.environ["SOURCE_DATE_EPOCH"])),
    )  # fmt: skip
    (doc / "changelog.Debian.gz").write_bytes(gzip.compress(entry.encode(), 9, mtime=0))
    code = (
        "import sys; from pathlib import Path; from uros.tools.agent.ament import make_package;"
        "make_package(Path(sys.argv[1]), ['/usr/bin/uros', 'agent'], Path(sys.argv[2]))"
    )
    subprocess.run(
        [sys.executable, "-B", "-c", code, str(root / AMENT), f"/{AMENT}"],
        env={**os.environ, "PYTHONPATH": str(packages)}, check=True,
    )  # fmt: skip


def add_control(root: Path, version: str) -> None:
    folder = root / "DEBIAN"
    folder.mkdir()
    size = sum(-(-path.stat().st_size // 1024) for path in root.rglob("*") if path.is_file())
    (folder / "control").write_text(
        _CONTROL.format(version=version, size=size, maintainer=maintainer())
    )
    (folder / "conffiles").write_text("/etc/uros/agent.toml\n")
    for name in SCRIPTS:
        shutil.copyfile(DEPLOY / "debian" / name, folder / name)
        (folder / name).chmod(0o755)


def set_modes(root: Path) -> None:
    """Make modes independent of the umask."""
    for path in (root, *root.rglob("*")):
        executable = path.is_dir() or path.stat().st_mode & 0o100
        path.chmod(0o755 if executable else 0o644)


def set_source_date() -> None:
    """Set SOURCE_DATE_EPOCH to the time of the last commit, if it is not set."""
    if "SOURCE_DATE_EPOCH" not in os.environ:
        command = ["git", "log", "-1", "--format=%ct"]
        done = subprocess.run(command, cwd=env.ROOT, stdout=subprocess.PIPE, text=True)
        os.environ["SOURCE_DATE_EPOCH"] = done.stdout.strip() or "315532800"


def build(output: Path) -> Path:
    """Build the package in a folder; return its path."""
    output.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as scratch:
        root = Path(scratch) / "uros"
        wheel = build_wheel(Path(scratch))
        lay_out(root, wheel)
        for left in root.rglob("__pycache__"):
            shutil.rmtree(left)
        version = version_of(wheel)
        add_control(root, version)
        set_modes(root)
        package = output / f"uros_{version}_all.deb"
        command = ["dpkg-deb", "--root-owner-group", "-Zxz", "--build", str(root), str(package)]
        subprocess.run(command, stdout=subprocess.DEVNULL, check=True)
    return package


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--output", type=Path, default=env.ROOT / "dist", metavar="FOLDER")
    output = parser.parse_args().output
    if not shutil.which("dpkg-deb"):
        sys.exit("deb: there is no dpkg-deb; on Debian and Ubuntu: sudo apt-get install dpkg")
    set_source_date()
    print(build(output))


if __name__ == "__main__":
    main()
