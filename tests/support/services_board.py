"""The board of tests/firmware/services with an agent process and a real rclpy node."""

import os
import shutil
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

from conftest import ROOT

from support.middleware import WITH_SERVICES
from support.peer import RosPeer
from uros.boards.virtual.engine.runner import RunningBoard

SCRIPT = Path(__file__).parent.parent / "interop" / "board_peer.py"
HARDWARE = "ra6m5_sensor_node"
SECONDS = 30.0


@contextmanager
def agent_process(device, domain, middleware=WITH_SERVICES):
    """A process of ``uros agent`` on a serial line."""
    command = [sys.executable, "-m", "uros", "agent", "serial", "-D", device, "-m", middleware]
    process = subprocess.Popen(
        [*map(str, command), "--domain", str(domain), "--stop-at-eof"],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        env=dict(os.environ, PYTHONPATH=str(ROOT / "src")),
    )  # fmt: skip
    output = ""
    try:
        yield process
    finally:
        try:
            output, _ = process.communicate("", SECONDS)
        finally:
            process.kill()
            process.wait()
    assert process.returncode == 0 and "internal error" not in output, output


@contextmanager
def running_board(folder, engine, name):
    """Run the board on an engine, with ``name`` as its name."""
    program = folder / name
    shutil.copytree(ROOT / "tests/firmware/services", program)
    (program / "config.py").write_text(f"NAME = {name!r}\n")
    form = "mpy" if engine == "micropython" else "py"
    with RunningBoard(
        program, board=HARDWARE, engine=engine, form=form, link=folder / f"tty_{name}"
    ) as board:
        yield board


@contextmanager
def board_and_peer(python, folder, engine, domain, middleware=WITH_SERVICES):
    """Run board, agent and peer: (the node's full name, the RosPeer of board_peer.py)."""
    name = f"{engine}_camera"
    with (
        RosPeer(python, domain, SCRIPT) as peer,
        running_board(folder, engine, name) as board,
        agent_process(board.path, domain, middleware),
    ):
        yield f"/{name}/{name}", peer
