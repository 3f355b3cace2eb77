"""Writes boards/builder/foreign_names.txt: the names of MicroPython and of boards' firmware.

::

    .venv/bin/python scripts/foreign_names.py

Each line is a kind and a name: an ``attribute`` of a type, a ``builtin``, or a builtin ``class``.
They are the names of MicroPython 1.27, from the interpreter of the tests, and attributes of modules
that only the firmware of boards has: the latter are listed here, after MicroPython's documentation.
The board builder does not reuse any of these names. The file is in the tree, so that a build is the
same on every Python. Run this again when the version of MicroPython changes, or when a board has
names that are not listed.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).resolve().parents[1]
FILE: Final = ROOT / "src/uros/boards/builder/foreign_names.txt"
FILE.touch()  # the next import reads it
sys.path.insert(0, str(ROOT / "tests"))

from mpy.harness import MicroPython  # noqa: E402

# Attributes of machine, network, socket, ssl, pyb, usb.device and streams of asyncio.
_OF_BOARDS: Final = (
    "accept active any base_mac bind bitstream calibration cancel config connect datetime deepsleep"
    " deinit desc_cfg desc_dev desc_strs disable_irq disconnect done drain drive duty duty_ns"
    " duty_u16 enable_irq feed fileno flush freq get_ciphers get_extra_info getpeercert high idle"
    " ifconfig info init interface ioctl ipconfig ipoll irq is_open isconnected lightsleep listen"
    " load_cert_chain load_verify_locations low makefile mode modify off on open_itf_cb poll pull"
    " put read_u16 read_uv readblocks readexactly readfrom readfrom_into readfrom_mem"
    " readfrom_mem_into recv recvfrom register reset reset_cause scan sendall sendbreak sendto"
    " set_ciphers setblocking setfilter setsockopt settimeout sleep start state status stop"
    " submit_xfer time_pulse_us toggle txdone unique_id unregister value verify_mode wait_closed"
    " wait_usb width wrap_socket write_readinto writeblocks writeto writeto_mem writevto"
    " xfer_pending"
).split()
# Attributes of MicroPython's objects that dir() does not return.
_HIDDEN: Final = (
    "args coro data errno imag itemsize machine nodename real release start step stop sysname value"
    " version"
).split()

_ASK: Final = """
import builtins
import re

MODULES = (
    "_asyncio array asyncio asyncio.core asyncio.event asyncio.lock binascii builtins collections"
    " deflate hashlib io json math os random re select struct sys time uctypes vfs"
)
names = set()

def visit(cls):
    for name in dir(cls):
        names.add("attribute " + name)

def generator():
    yield

for full in MODULES.split():
    module = __import__(full)
    for part in full.split(".")[1:]:
        module = getattr(module, part)
    for name in dir(module):
        member = getattr(module, name)
        visit(member if isinstance(member, type) else type(member))
regex = re.compile("a")
for value in (generator(), iter([]), iter({}), {}.items(), print, visit, regex, regex.match("a")):
    visit(type(value))
for name in dir(builtins):
    names.add(("class " if isinstance(getattr(builtins, name), type) else "builtin ") + name)
for name in names:
    print(name)
"""


def file_text() -> str:
    """The text of the file."""
    with MicroPython() as board:
        names_found = board.run(_ASK).splitlines()
    names = {*names_found, *("attribute " + name for name in (*_OF_BOARDS, *_HIDDEN))}
    public = sorted(name for name in names if not name.partition(" ")[2].startswith("_"))
    return "\n".join(["# Made by scripts/foreign_names.py", *public, ""])


if __name__ == "__main__":
    FILE.write_text(file_text(), encoding="utf-8")
