"""The transports of ``uros agent``: declares their options and creates them."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from ....agent.transports.base import DEFAULT_PORT

if TYPE_CHECKING:
    from ....agent.transports.base import ServerTransport

DEFAULT_DISCOVERY_PORT: Final = 7400
# The transports that listen on a port.
IP: Final = ("udp4", "udp6", "tcp4", "tcp6")
_TLS: Final = {
    "--tls-cert": "enable TLS with this certificate of the agent: PEM, followed by the certificates"
    " that lead to its CA",
    "--tls-key": "private key of the certificate: PEM, not encrypted",
    "--tls-ca": "admit only clients with a certificate that this CA signed: PEM (docs/security.md)",
    "--tls-crl": "refuse clients with a certificate that this list of the CA revokes: PEM",
}


def port(text: str) -> int:
    """Parse a port to listen on, 0 to 65535."""
    if not text.isdecimal() or int(text) > 65535:
        raise argparse.ArgumentTypeError(f"{text!r} is not a port (0 to 65535)")
    return int(text)


# --- the options of each transport ------------------------------------------------------------


def _add_port(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "-p", "--port", type=port, default=DEFAULT_PORT, metavar="N",
        help=f"port to listen on (default: {DEFAULT_PORT}; 0: any free one)",
    )  # fmt: skip


def _add_tcp(parser: argparse.ArgumentParser) -> None:
    _add_port(parser)
    for option, help_text in _TLS.items():
        parser.add_argument(option, metavar="FILE", help=help_text)


def _add_serial(parser: argparse.ArgumentParser) -> None:
    which = parser.add_mutually_exclusive_group(required=True)
    which.add_argument(
        "-D", "--dev", metavar="DEVICE",
        help="serial device, such as /dev/ttyACM0, COM3, socket://HOST:PORT or"
        " rfc2217://HOST:PORT",
    )  # fmt: skip
    which.add_argument("-f", "--file", metavar="FILE", help="file that holds the device's name")
    _add_baudrate(parser)
    _add_control_lines(parser)


class _Devices(argparse.Action):
    """Makes a list of devices, several of which may be in one argument, as of the C++ agent."""

    def __call__(
        self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, values: Any,
        option_string: str | None = None,
    ) -> None:  # fmt: skip
        setattr(namespace, self.dest, " ".join(values).split())


def _add_multiserial(parser: argparse.ArgumentParser) -> None:
    which = parser.add_mutually_exclusive_group(required=True)
    which.add_argument(
        "-D", "--devs", metavar="DEVICE", nargs="+", action=_Devices,
        help="serial devices; the name of another transport ends the list",
    )  # fmt: skip
    which.add_argument("-f", "--file", metavar="FILE", help="file with one device on each line")
    _add_baudrate(parser)
    _add_control_lines(parser)


def _add_baudrate(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "-b", "--baudrate", type=_baudrate, default=115200, metavar="N",
        help="baud rate (default: 115200)",
    )  # fmt: skip


def _add_control_lines(parser: argparse.ArgumentParser) -> None:
    for line in ("dtr", "rts"):
        parser.add_argument(
            f"--{line}", type=_on_off, metavar="on|off",
            help=f"set the control line {line.upper()} after opening (default: as the system does)",
        )  # fmt: skip


def _add_canfd(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "-D", "--dev", metavar="NAME", required=True, help="CAN interface, such as can0"
    )
    parser.add_argument(
        "--interface", default="socketcan", metavar="KIND",
        help="kind of adapter, as python-can names it (default: socketcan)",
    )  # fmt: skip
    # Accepted because the C++ agent has it; ignored, as there, because boards choose their CAN ids.
    parser.add_argument("-I", "--id", help=argparse.SUPPRESS)


def _add_rfcomm(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--address", metavar="AA:BB:CC:DD:EE:FF",
        help="Bluetooth address of the board to connect to (default: wait for boards to connect)",
    )  # fmt: skip
    parser.add_argument(
        "--channel", type=_channel, default=1, metavar="N",
        help="RFCOMM channel, 1 to 30 (default: 1)",
    )  # fmt: skip


def _add_custom(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "spec", metavar="MODULE:CLASS", help="the transport's class; or FILE.py:CLASS"
    )
    parser.add_argument(
        "-a", "--argument", action="append", default=[], metavar="TEXT", dest="arguments",
        help="argument for the constructor of the class; may be repeated",
    )  # fmt: skip


def _channel(text: str) -> int:
    if not text.isdecimal() or not 1 <= int(text) <= 30:
        raise argparse.ArgumentTypeError(f"{text!r} is not an RFCOMM channel (1 to 30)")
    return int(text)


def _baudrate(text: str) -> int:
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"{text!r} is not a baud rate, such as 115200")
    return int(text)


def _on_off(text: str) -> bool:
    if text not in ("on", "off"):
        raise argparse.ArgumentTypeError(f"{text!r} is neither on nor off")
    return text == "on"


# --- the transports themselves ----------------------------------------------------------------


def _udp(args: argparse.Namespace) -> list[ServerTransport]:
    from ....agent.transports.udp import UdpServer

    return [UdpServer(args.port, anywhere(args.transport))]


def _tcp(args: argparse.Namespace) -> list[ServerTransport]:
    files = [args.tls_cert, args.tls_key, args.tls_ca, args.tls_crl]
    if any(file is not None for file in files):
        from ....agent.transports.tls import tls_server

        return [tls_server(args.port, anywhere(args.transport), *files)]
    from ....agent.transports.tcp import TcpServer

    return [TcpServer(args.port, anywhere(args.transport))]


def anywhere(transport: str) -> str:
    """Return the address on which a transport of :data:`IP` listens: all of its family."""
    return "::" if transport.endswith("6") else "0.0.0.0"


def _serial(args: argparse.Namespace) -> list[ServerTransport]:
    from ....agent.transports.serial import serial_server

    is_file = args.file is not None
    device = args.file if is_file else args.dev
    return [serial_server(device, args.baudrate, is_file, args.dtr, args.rts)]


def _multiserial(args: argparse.Namespace) -> list[ServerTransport]:
    from ....agent.transports.multiserial import devices_in, serial_servers

    devices = args.devs if args.file is None else devices_in(args.file)
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


class Transport(NamedTuple):
    """A transport that ``uros agent`` offers.

    Attributes:
        help: What it is, for the help.
        add_options: Declares its options.
        make: Creates it from its parsed options; multiserial creates one for each device.
    """

    help: str
    add_options: Callable[[argparse.ArgumentParser], None]
    make: Callable[[argparse.Namespace], list[ServerTransport]]


TRANSPORTS: Final = {
    "udp4": Transport("UDP over IPv4", _add_port, _udp),
    "udp6": Transport("UDP over IPv6", _add_port, _udp),
    "tcp4": Transport("TCP over IPv4, with or without TLS", _add_tcp, _tcp),
    "tcp6": Transport("TCP over IPv6, with or without TLS", _add_tcp, _tcp),
    "serial": Transport("a serial device", _add_serial, _serial),
    "multiserial": Transport("several serial devices", _add_multiserial, _multiserial),
    "pseudoterminal": Transport(
        "a pseudo-terminal that the agent makes", _add_baudrate, _pseudoterminal
    ),
    "canfd": Transport("a CAN FD interface", _add_canfd, _canfd),
    "rfcomm": Transport("Bluetooth RFCOMM", _add_rfcomm, _rfcomm),
    "custom": Transport(
        "a transport class of your own (docs/custom_transport.md)", _add_custom, _custom
    ),
}


def make(args: argparse.Namespace) -> list[ServerTransport]:
    """Create the transports that one part of the command line names, with its options.

    Raises:
        TransportError: The transport cannot be used.
    """
    return TRANSPORTS[args.transport].make(args)


def make_discovery(port: int, transports: list[ServerTransport]) -> ServerTransport:
    """Create the transport that answers boards that search for an agent by multicast.

    Args:
        port: UDP port to listen on.
        transports: The agent's other transports, whose ports it answers with. The server must open
            them first.
    """
    from ....agent.transports.discovery import DiscoveryServer

    return DiscoveryServer(transports, port)
