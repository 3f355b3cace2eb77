"""The transports of ``uros agent``: their options, and what is made of them."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Final

from ....agent.transports.base import DEFAULT_PORT

if TYPE_CHECKING:
    from ....agent.transports.base import ServerTransport

TRANSPORTS: Final = {
    "udp4": "UDP over IPv4",
    "udp6": "UDP over IPv6",
    "tcp4": "TCP over IPv4",
    "tcp6": "TCP over IPv6",
    "serial": "a serial device",
    "multiserial": "several serial devices",
    "pseudoterminal": "a pseudo-terminal of its own",
    "canfd": "a CAN FD interface",
    "rfcomm": "Bluetooth RFCOMM",
    "custom": "a transport of your own, a class (docs/custom_transport.md)",
}
DEFAULT_DISCOVERY_PORT: Final = 7400
_TLS: Final = {
    "--tls-cert": "speak TLS: the agent's certificate, PEM, and below it those that lead to its CA",
    "--tls-key": "private key of the certificate, PEM, not encrypted",
    "--tls-ca": "only clients with a certificate that this CA has signed, PEM (docs/security.md)",
}
_BY_PORT: Final = ("udp4", "udp6", "tcp4", "tcp6")


def port(text: str) -> int:
    if not text.isdecimal() or int(text) > 65535:
        raise argparse.ArgumentTypeError(f"{text!r} is no port (0 to 65535)")
    return int(text)


def add_transport(name: str, parser: argparse.ArgumentParser) -> None:
    """The options of one transport."""
    if name in _BY_PORT:
        parser.add_argument(
            "-p", "--port", type=port, default=DEFAULT_PORT, metavar="N",
            help=f"port to listen on (default {DEFAULT_PORT}; 0: any that is free)",
        )  # fmt: skip
        if name.startswith("tcp"):
            for option, help_text in _TLS.items():
                parser.add_argument(option, metavar="FILE", help=help_text)
        return
    if name == "canfd":
        parser.add_argument("-D", "--dev", metavar="NAME", required=True, help="such as can0")
        parser.add_argument(
            "--interface", default="socketcan", metavar="KIND",
            help="what python-can reaches it by (default socketcan)",
        )  # fmt: skip
        # The C++ agent takes it too, and has no use for it: boards choose their ids.
        parser.add_argument("-I", "--id", help=argparse.SUPPRESS)
        return
    if name == "custom":
        parser.add_argument(
            "spec", metavar="MODULE:CLASS", help="the class, or FILE.py:CLASS"
        )
        parser.add_argument(
            "-a", "--argument", action="append", default=[], metavar="TEXT", dest="arguments",
            help="an argument for its constructor; may be repeated",
        )  # fmt: skip
        return
    if name == "rfcomm":
        parser.add_argument(
            "--address", metavar="AA:BB:CC:DD:EE:FF",
            help="the board's, to connect to it (default: wait for boards that connect)",
        )  # fmt: skip
        parser.add_argument(
            "--channel", type=_channel, default=1, metavar="N", help="1 to 30 (default 1)"
        )
        return
    if name == "serial":
        which = parser.add_mutually_exclusive_group(required=True)
        which.add_argument(
            "-D", "--dev", metavar="DEVICE",
            help="such as /dev/ttyACM0, COM3, socket://HOST:PORT or rfc2217://HOST:PORT",
        )  # fmt: skip
        which.add_argument("-f", "--file", metavar="FILE", help="file with the device's name")
    if name == "multiserial":
        which = parser.add_mutually_exclusive_group(required=True)
        which.add_argument("-D", "--devs", metavar="DEVICE", nargs="+", help="several devices")
        which.add_argument("-f", "--file", metavar="FILE", help="file with a device a line")
    parser.add_argument(
        "-b", "--baudrate", type=_baudrate, default=115200, metavar="N", help="default 115200"
    )
    if name != "pseudoterminal":
        for line in ("dtr", "rts"):
            parser.add_argument(
                f"--{line}", type=_on_off, metavar="on|off",
                help=f"set the line {line.upper()} after opening (default: the system's way)",
            )  # fmt: skip


def _channel(text: str) -> int:
    if not text.isdecimal() or not 1 <= int(text) <= 30:
        raise argparse.ArgumentTypeError(f"{text!r} is no RFCOMM channel (1 to 30)")
    return int(text)


def _baudrate(text: str) -> int:
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"{text!r} is no baud rate, such as 115200")
    return int(text)


def _on_off(text: str) -> bool:
    if text not in ("on", "off"):
        raise argparse.ArgumentTypeError(f"{text!r} is neither on nor off")
    return text == "on"


def make(args: argparse.Namespace) -> list[ServerTransport]:
    """The transports of one part of the command line. Raises TransportError."""
    made: list[ServerTransport] = _MAKERS[args.transport](args)
    return made


def _udp(args: argparse.Namespace) -> list[ServerTransport]:
    from ....agent.transports.udp import UdpServer

    return [UdpServer(args.port, _anywhere(args.transport))]


def _tcp(args: argparse.Namespace) -> list[ServerTransport]:
    if args.tls_cert is not None or args.tls_key is not None or args.tls_ca is not None:
        from ....agent.transports.tls import tls_server

        where = _anywhere(args.transport)
        return [tls_server(args.port, where, args.tls_cert, args.tls_key, args.tls_ca)]
    from ....agent.transports.tcp import TcpServer

    return [TcpServer(args.port, _anywhere(args.transport))]


def _anywhere(transport: str) -> str:
    return "::" if transport.endswith("6") else "0.0.0.0"


def _serial(args: argparse.Namespace) -> list[ServerTransport]:
    from ....agent.transports.serial import serial_server

    is_file = args.file is not None
    device = args.file if is_file else args.dev
    return [serial_server(device, args.baudrate, is_file, args.dtr, args.rts)]


def _multiserial(args: argparse.Namespace) -> list[ServerTransport]:
    from ....agent.transports.multiserial import devices_in, serial_servers

    # The C++ agent takes one word with spaces in it.
    devices = " ".join(args.devs).split() if args.file is None else devices_in(args.file)
    return [*serial_servers(devices, args.baudrate, args.dtr, args.rts)]


def _pseudoterminal(args: argparse.Namespace) -> list[ServerTransport]:
    from ....agent.transports.serial import PseudoTerminalServer

    return [PseudoTerminalServer(args.baudrate)]


def _canfd(args: argparse.Namespace) -> list[ServerTransport]:
    from ....agent.transports.can import CanServer

    return [CanServer(args.dev, args.interface)]


def _rfcomm(args: argparse.Namespace) -> list[ServerTransport]:
    from ....agent.transports.rfcomm import RfcommListener, RfcommServer

    if args.address:
        return [RfcommServer(args.address, args.channel)]
    return [RfcommListener(args.channel)]


def _custom(args: argparse.Namespace) -> list[ServerTransport]:
    from ....agent.transports.custom import CustomServer, load

    return [CustomServer(load(args.spec, args.arguments))]


_MAKERS: Final = {
    "udp4": _udp,
    "udp6": _udp,
    "tcp4": _tcp,
    "tcp6": _tcp,
    "serial": _serial,
    "multiserial": _multiserial,
    "pseudoterminal": _pseudoterminal,
    "canfd": _canfd,
    "rfcomm": _rfcomm,
    "custom": _custom,
}


def make_discovery(port: int, transports: list[ServerTransport]) -> ServerTransport:
    """What answers boards that ask where the agent is; behind the others in a server's list."""
    from ....agent.transports.discovery import DiscoveryServer

    return DiscoveryServer(transports, port)
