"""Runs uros in an emulated Debian on arm64: ``make test-arm64``.

    arm64.py [--fresh] [PYTEST ARGUMENT]...

The first run makes the system in build/arm64 by debootstrap, which takes five minutes; --fresh
makes it anew. Programs of arm64 run by qemu-user-static, which binfmt_misc calls. In it

1. ``pip install .`` in an environment without a compiler,
2. ``make demo``, with SECONDS of the environment (20),
3. the unit tests that ``make quick`` runs, or what the arguments name.

What runs has a network namespace of its own: its DDS traffic reaches nothing else. Only installing
uses the host's network, with the host's certificates and pip's settings of it.

It needs root, debootstrap and qemu-user-static, and installs the latter two by apt-get. The exit
status is 0 only if every step passes.
"""

import argparse
import os
import platform
import shutil
import ssl
import subprocess
import sys
from pathlib import Path

import env

HERE = env.ROOT / "build" / "arm64"
DEBIAN = HERE / "debian"
SUITE = "bookworm"
PACKAGES = ("ca-certificates", "git", "iproute2", "make", "procps", "python3", "python3-venv")
# Where the project is in there.
PROJECT = Path("/root/uros")
CERTIFICATES = Path("/etc/ssl/certs/of-the-host.crt")

BINFMT = Path("/proc/sys/fs/binfmt_misc")
QEMU = "qemu-aarch64-static"
# The header of an ELF file of arm64, and which of its bits count.
_MAGIC = "7f454c460201010000000000000000000200b700"
_MASK = "ffffffffffffff00fffffffffffffffffeffffff"

# Files and tests that fail by what qemu-user 7.2 does not emulate; the hardware runs them.
_RATE, _GROUPS = "the ioctl TCSETS2", "options of multicast sockets"
_SPEED = "the speed of the hardware"
_TRANSPORTS = "tests/unit/agent/transports"
_UDP = "tests/unit/middleware/rtps/test_udp.py"
NOT_EMULATED = {
    f"{_TRANSPORTS}/test_baud.py": _RATE,
    f"{_TRANSPORTS}/test_can.py": "options of CAN sockets",
    f"{_TRANSPORTS}/test_discovery.py": _GROUPS,
    f"{_TRANSPORTS}/test_serial.py::test_a_custom_rate_and_modem_lines_that_a_line_lacks": _RATE,
    f"{_TRANSPORTS}/test_terminal.py::test_a_failed_open_leaves_no_descriptor_open": _RATE,
    "tests/unit/tools/doctor/test_serial.py::test_a_board_on_a_pseudo_terminal": _RATE,
    "tests/unit/agent/policy/test_admission.py"
    "::test_discovery_does_not_answer_peers_outside_the_networks": _GROUPS,
    f"{_UDP}::test_only_the_multicast_port_is_shared": _GROUPS,
    f"{_UDP}::test_an_interface_without_multicast_is_tried_again": _GROUPS,
    f"{_UDP}::test_announcements_by_multicast_come_back": _GROUPS,
    f"{_UDP}::test_announcements_come_from_joined_interfaces_alone": _GROUPS,
    f"{_UDP}::test_datagrams_wait_where_no_further_socket_can_be_opened": _GROUPS,
    "tests/unit/agent/observability/test_prometheus.py"
    "::test_a_scrape_has_the_values_of_the_snapshot": "a process's memory in /proc",
    "tests/unit/boards/virtual/world/test_rover.py"
    "::test_the_simulation_is_twenty_times_faster_than_real_time": _SPEED,
    "tests/unit/tools/multicast/test_multicast.py::test_a_group_is_joined_on_this_machine": _GROUPS,
    "tests/unit/agent/test_server.py::test_a_hostile_client_cannot_make_a_turn_long": _SPEED,
}
# What needs `env.py micropython` or tshark, which are not installed in there.
NOT_INSTALLED = (
    "tests/unit/tools/board/test_moved_imports.py::test_run[micropython]",
    "tests/unit/tools/capture/test_recordings.py::test_a_file_of_wireshark",
)


def check() -> None:
    """Check for root, and prepare debootstrap and the emulation. Raises env.Unavailable."""
    if sys.platform != "linux" or os.geteuid() != 0:
        raise env.Unavailable(
            "make test-arm64 needs root on Linux: it makes a Debian with debootstrap and chroot",
            "run it as root, as in a container or with sudo",
        )
    packages = {"debootstrap": "debootstrap", QEMU: "qemu-user-static", "unshare": "util-linux"}
    if platform.machine() == "aarch64":
        del packages[QEMU]
    missing = [package for name, package in packages.items() if not shutil.which(name)]
    if missing and not env.apt_install(*missing):
        raise env.Unavailable(f"there is no {' and no '.join(missing)}", "install it")
    if platform.machine() != "aarch64" and not is_emulated():
        register()


def is_emulated() -> bool:
    """Whether binfmt_misc runs programs of arm64, in a chroot too (flag F)."""
    for file in BINFMT.glob("*"):
        if file.name in ("register", "status"):
            continue
        lines = file.read_text().split("\n")
        flags = next((line[7:] for line in lines if line.startswith("flags: ")), "")
        if lines[0] == "enabled" and f"magic {_MAGIC}" in lines and "F" in flags:
            return True
    return False


def register() -> None:
    """Have binfmt_misc call qemu until the machine restarts. Raises env.Unavailable."""
    if not (BINFMT / "register").exists():
        env.succeeds("mount", "-t", "binfmt_misc", "binfmt_misc", BINFMT)
    magic, mask = ("".join(f"\\x{byte:02x}" for byte in bytes.fromhex(x)) for x in (_MAGIC, _MASK))
    entry = f":uros-arm64:M::{magic}:{mask}:{shutil.which(QEMU)}:F"
    try:
        (BINFMT / "register").write_text(entry)
    except OSError as error:
        raise env.Unavailable(
            f"make test-arm64 needs binfmt_misc, which cannot be set up here ({error})",
            "run it on a machine, or in a privileged container, whose kernel has binfmt_misc",
        ) from error


def make_debian() -> None:
    """Make the system, unless it is there. Raises env.Unavailable."""
    stamp = env.Stamp(HERE)
    made_from = {"suite": SUITE, "packages": PACKAGES, "complete": True}
    if stamp.read() == dict(made_from, packages=list(PACKAGES)):
        return
    env.say(f"making Debian {SUITE} for arm64 in build/arm64: 500 MB, about five minutes")
    stamp.start({})
    env.run(
        "debootstrap",
        ["debootstrap", "--arch=arm64", "--foreign", "--variant=minbase",
         "--include=" + ",".join(PACKAGES), SUITE, DEBIAN],
    )  # fmt: skip
    env.run("debootstrap", ["chroot", DEBIAN, "/debootstrap/debootstrap", "--second-stage"])
    stamp.write(made_from)


def settings() -> dict:
    """The environment of programs in there; the host's certificates and settings of pip."""
    inside = {
        "HOME": "/root",
        "LANG": "C.UTF-8",
        "PATH": "/usr/sbin:/usr/bin:/sbin:/bin",
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
    }
    for name, value in os.environ.items():
        if name.lower() in ("http_proxy", "https_proxy", "no_proxy") or (
            name.startswith("PIP_") and "/" not in value
        ):
            inside[name] = value
    for option in ("index-url", "trusted-host", "proxy"):
        command = [sys.executable, "-m", "pip", "config", "get", f"global.{option}"]
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode == 0 and "file:" not in done.stdout:
            inside["PIP_" + option.upper().replace("-", "_")] = done.stdout.strip()
    bundle = os.environ.get("SSL_CERT_FILE") or ssl.get_default_verify_paths().cafile
    if bundle and Path(bundle).exists():
        shutil.copy(bundle, DEBIAN / CERTIFICATES.relative_to("/"))
        inside |= dict.fromkeys(("PIP_CERT", "SSL_CERT_FILE"), str(CERTIFICATES))
    for file in ("etc/resolv.conf", "etc/hosts"):
        shutil.copy(Path("/") / file, DEBIAN / file)
    return inside


def copy_project() -> None:
    """Copy the files of the project that git knows, or would add; .venv there stays."""
    target = DEBIAN / PROJECT.relative_to("/")
    target.mkdir(parents=True, exist_ok=True)
    for old in target.iterdir():
        if old.is_dir() and old.name != ".venv":
            shutil.rmtree(old)
        elif not old.is_dir():
            old.unlink()
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=env.ROOT, check=True, stdout=subprocess.PIPE,
    ).stdout.decode()  # fmt: skip
    for name in filter(None, listed.split("\0")):
        if (env.ROOT / name).is_file():
            (target / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(env.ROOT / name, target / name)


def inside(step: str, script: str, variables: dict, network: bool = False) -> bool:
    """Run a shell script in there, in a namespace of its own; whether it passed."""
    env.say(f"arm64: {step}")
    # Groups are joined where routes lead to, so that one is needed.
    loopback = "ip link set lo up\nip route add 224.0.0.0/4 dev lo\n"
    prepare = "" if network else loopback
    # The mounts are gone with the namespace.
    prepare += f"""
        mount --bind {DEBIAN} {DEBIAN}
        mount -t proc proc {DEBIAN}/proc
        mount -t sysfs sysfs {DEBIAN}/sys
        mount --rbind /dev {DEBIAN}/dev
    """
    assignments = [f"{name}={value}" for name, value in variables.items()]
    command = [
        "unshare", "--mount", "--propagation", "private", *([] if network else ["--net"]),
        "sh", "-ec", prepare + 'exec chroot "$@"', "sh", DEBIAN,
        "/usr/bin/env", "-i", *assignments, "sh", "-ec", f"cd {PROJECT}\n{script}",
    ]  # fmt: skip
    passed = subprocess.run([str(part) for part in command]).returncode == 0
    env.say(f"arm64: {step}: {'passed' if passed else 'FAILED'}")
    return passed


INSTALL = """
uname -m
if command -v cc gcc; then exit 1; fi
rm -rf /root/plain
python3 -m venv /root/plain
/root/plain/bin/pip install -q .
/root/plain/bin/pip list
cd /
/root/plain/bin/uros --version
"""
# Not `env.py test`, which also installs tshark, for tests that are not run here.
PREPARE = 'cd scripts\npython3 -c \'import env; env.uros("run"); env.uros("test")\'\n'
TESTS = (
    '.venv/bin/pytest -q -n 0 -p no:cacheprovider -m "not slow and not long"'
    " --hypothesis-profile=quick --timeout 1800 --tb=short"
)


def main() -> None:
    parser = argparse.ArgumentParser(usage=__doc__)
    parser.add_argument("--fresh", action="store_true")
    options, chosen = parser.parse_known_args()
    try:
        check()
        if options.fresh:
            env.Stamp(HERE).write({})
        make_debian()
    except env.Unavailable as error:
        sys.exit(f"arm64: {error.reason}\narm64: {error.remedy}")
    copy_project()
    variables = settings()
    left_out = {} if platform.machine() == "aarch64" else NOT_EMULATED
    for path, lacks in left_out.items():
        env.say(f"arm64: {path} is left out: the emulator lacks {lacks}")
    options_out = [
        f"--deselect '{path}'" if "::" in path else f"--ignore {path}"
        for path in (*left_out, *NOT_INSTALLED)
    ]
    tests = [TESTS, *options_out, *(chosen or ["tests/unit"])]
    steps = (
        inside("pip install", INSTALL, variables, network=True),
        inside("the environment of the tests", PREPARE, variables, network=True)
        and inside("make demo", f"make demo SECONDS={os.environ.get('SECONDS', 20)}", variables)
        and inside("the quick tests", " ".join(tests), variables),
    )
    sys.exit(0 if all(steps) else 1)


if __name__ == "__main__":
    main()
