"""``uros pid``: tune the wheel controllers of a rover, with a live plot in a browser.

It is the peer of the rover's tuning program: the rover connects over TCP and sends its torques, and
receives ``R_Kp,R_Ki,R_Kd,L_Kp,L_Ki,L_Kd,speed,rot``, typed in the page or in the terminal.
"""

from __future__ import annotations

import argparse
import sys
import threading
from typing import Any, Final

from ...dashboard.serve import Answer, as_json, number
from ...dashboard.tuning import Tuning
from ...printable import printable
from ..pages import add_page_arguments, bind_error, open_pages, port_number

PORT: Final = 10001
PAGE_PORT: Final = 8091
_WAIT_SECONDS: Final = 1.0
_EXAMPLE: Final = "200,30,5,200,30,5,1.0,0"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros pid``."""
    parser.add_argument(
        "--port",
        metavar="N",
        type=port_number,
        default=PORT,
        help=f"TCP port that the rover connects to (default: {PORT})",
    )
    parser.add_argument(
        "--host",
        metavar="ADDRESS",
        default="0.0.0.0",
        help="address that the rover connects to (default: all addresses of this machine)",
    )
    add_page_arguments(parser, PAGE_PORT, "page-")


def run(args: argparse.Namespace) -> int:
    """Serve the rover and the page until Ctrl-C.

    Raises:
        ToolError: A port is in use.
    """
    try:
        tuning = Tuning(args.host, args.port)
    except OSError as error:
        raise bind_error("the rover's port", args.host, args.port, "--port", error) from error
    try:
        pages = open_pages(
            args, ("pid.html", "page.css", "pid.js"),
            get={"/state": lambda query: _state(tuning, query)},
            post={"/gains": lambda value: _gains(tuning, value)},
            option="--page-port",
        )  # fmt: skip
        print(
            f"shown at {pages.url}\n"
            f"waiting for the rover on TCP port {tuning.port}; reset it if it does not connect\n"
            f"to drive, type R_Kp,R_Ki,R_Kd,L_Kp,L_Ki,L_Kd,speed,rot here or in the page,"
            f" such as {_EXAMPLE}",
            flush=True,
        )
        threading.Thread(target=_listen, args=(tuning,), daemon=True).start()
        last = 0
        try:
            while True:
                last, fresh = tuning.notes_since(last, _WAIT_SECONDS)
                for text in fresh:
                    print(printable(text), flush=True)
        finally:
            pages.close()
    except KeyboardInterrupt:
        return 0
    finally:
        tuning.close()


def _state(tuning: Tuning, query: dict[str, str]) -> Answer:
    return as_json(tuning.snapshot(number(query, "version"), _WAIT_SECONDS))


def _gains(tuning: Tuning, value: Any) -> Answer:
    line = value.get("line") if isinstance(value, dict) else None
    if not isinstance(line, str):
        return as_json({"error": 'send {"line": "R_Kp,…"}'}, 400)
    try:
        return as_json({"sent": tuning.send(line)})
    except ValueError as error:
        return as_json({"error": str(error)}, 409)


def _listen(tuning: Tuning) -> None:
    """Send the lines that are typed in the terminal."""
    for line in sys.stdin:
        if line.strip():
            try:
                tuning.send(line)
            except ValueError as error:
                print(f"not sent: {error}", file=sys.stderr, flush=True)
