"""What the verbs with a page in a browser have in common."""

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
    """``--port``, ``--host``, ``--no-open``; with ``prefix`` ``--page-port`` and so on."""
    parser.add_argument(
        f"--{prefix}port",
        metavar="N",
        type=port_number,
        default=port,
        dest="page_port",
        help=f"{about} TCP port, 0 for any that is free (default: {port})",
    )
    parser.add_argument(
        f"--{prefix}host",
        metavar="ADDRESS",
        default="127.0.0.1",
        dest="page_host",
        help=f"{about} address (default: 127.0.0.1, for this machine alone; 0.0.0.0 shows it to"
        " everyone in your network)",
    )
    parser.add_argument("--no-open", action="store_true", help="do not open a browser")


def port_number(text: str) -> int:
    if not text.isdecimal() or int(text) > 65535:
        raise argparse.ArgumentTypeError(f"{text!r} is no port; give 0 to 65535")
    return int(text)


def open_pages(
    args: argparse.Namespace,
    names: tuple[str, ...],
    get: Mapping[str, Get],
    post: Mapping[str, Post] | None = None,
    option: str = "--port",
) -> Pages:
    """Serve the pages and open a browser, as the options say. Raises ToolError."""
    try:
        pages = Pages(args.page_host, args.page_port, names, get, post)
    except OSError as error:
        raise bind_error("the page", args.page_host, args.page_port, option, error) from error
    if not args.no_open:
        show(pages.url)
    return pages


def bind_error(what: str, host: str, port: int, option: str, error: OSError) -> ToolError:
    """Why ``what`` has not got its port, in words."""
    if isinstance(error, socket.gaierror) or error.errno == errno.EADDRNOTAVAIL:
        return ToolError(f"{what}: {host} is no address of this machine; ip addr lists them")
    if error.errno == errno.EADDRINUSE:
        return ToolError(
            f"{what}: TCP port {port} is in use, perhaps by another uros: end that, or {option}"
            " with another number"
        )
    if error.errno == errno.EACCES:
        return ToolError(f"{what}: port {port} is for root; {option} with a number above 1023")
    return ToolError(f"{what} cannot be served at {host} port {port}: {error.strerror}")
