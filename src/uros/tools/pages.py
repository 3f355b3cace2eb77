"""Options and opening of the page, for the verbs with a page in a browser."""

from __future__ import annotations

import argparse
import errno
import socket
from collections.abc import Mapping

from ..dashboard.serve import Get, Pages, Post, show
from .errors import ToolError


def add_page_arguments(
    parser: argparse.ArgumentParser, port: int, prefix: str = "", about: str = "the page's"
) -> None:
    """Declare ``--port``, ``--host`` and ``--no-open``.

    Args:
        parser: Where to declare them.
        port: The default port.
        prefix: Put before the names, such as ``page-`` for ``--page-port``.
        about: Whose port and address these are, for the help.
    """
    parser.add_argument(
        f"--{prefix}port",
        metavar="N",
        type=port_number,
        default=port,
        dest="page_port",
        help=f"{about} TCP port (default: {port}; 0: any free one)",
    )
    parser.add_argument(
        f"--{prefix}host",
        metavar="ADDRESS",
        default="127.0.0.1",
        dest="page_host",
        help=f"{about} address (default: 127.0.0.1, this machine only; 0.0.0.0 opens it to your"
        " network)",
    )
    parser.add_argument("--no-open", action="store_true", help="do not open a browser")


def port_number(text: str) -> int:
    """Parse a TCP port, 0 to 65535."""
    if not text.isdecimal() or int(text) > 65535:
        raise argparse.ArgumentTypeError(f"{text!r} is not a port; give 0 to 65535")
    return int(text)


def open_pages(
    args: argparse.Namespace,
    names: tuple[str, ...],
    get: Mapping[str, Get],
    post: Mapping[str, Post] | None = None,
    option: str = "--port",
) -> Pages:
    """Serve the pages and open a browser, as the options say.

    Args:
        args: The command line.
        names: The files of the pages.
        get: Answers GET requests, by path.
        post: Answers POST requests, by path.
        option: The option of the port, for the error.

    Raises:
        ToolError: The port cannot be used.
    """
    try:
        pages = Pages(args.page_host, args.page_port, names, get, post)
    except OSError as error:
        raise bind_error("the page", args.page_host, args.page_port, option, error) from error
    if not args.no_open:
        show(pages.url)
    return pages


def bind_error(subject: str, host: str, port: int, option: str, error: OSError) -> ToolError:
    """Return the error that ``subject`` cannot use its port."""
    if isinstance(error, socket.gaierror) or error.errno == errno.EADDRNOTAVAIL:
        return ToolError(
            f"{subject}: {host} is not an address of this machine; 'ip addr' lists them"
        )
    if error.errno == errno.EADDRINUSE:
        return ToolError(
            f"{subject}: TCP port {port} is in use, perhaps by another uros: end that one, or give"
            f" another port with {option}"
        )
    if error.errno == errno.EACCES:
        return ToolError(
            f"{subject}: port {port} is reserved for root; give a port above 1023 with {option}"
        )
    return ToolError(f"{subject} cannot be served at {host} port {port}: {error.strerror}")
