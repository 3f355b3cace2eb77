"""Several serial devices in one agent.

Each device is a separate transport with its own reconnection, counters and sessions: a peer is
identified by transport and address, so boards with the same address on different devices are
different peers.
"""

from __future__ import annotations

import errno
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from .base import ServerTransport, TransportError
from .serial import serial_server

# Each device takes a descriptor, and is checked each half second while it is away.
MAX_DEVICES: Final = 256
_MAX_FILE: Final = 64 * 1024


def serial_servers(
    devices: Sequence[str], baud: int = 115200, dtr: bool | None = None, rts: bool | None = None
) -> list[ServerTransport]:
    """Make a transport for each device, by :func:`uros.agent.transports.serial.serial_server`.

    Raises TransportError for no device, too many, or one that is named twice.
    """
    if not devices:
        raise TransportError(errno.EINVAL, "no device is named: name some, such as /dev/ttyACM0")
    if len(devices) > MAX_DEVICES:
        raise TransportError(
            errno.EINVAL, f"{len(devices)} devices are over {MAX_DEVICES}: start another agent"
        )
    twice = sorted({device for device in devices if devices.count(device) > 1})
    if twice:
        raise TransportError(errno.EINVAL, f"{', '.join(twice)}: named twice; name it once")
    servers = []
    for device in devices:
        server = serial_server(device, baud, dtr=dtr, rts=rts)
        server.name = "MultiSerialAgent"
        servers.append(server)
    return servers


def devices_in(path: str) -> list[str]:
    """Read device names from a file, one a line; empty lines and ``#`` lines are skipped.

    Raises TransportError if the file cannot be used.
    """
    try:
        with Path(path).open("rb") as file:
            text = file.read(_MAX_FILE + 1)
        if len(text) > _MAX_FILE:
            raise TransportError(
                errno.EFBIG, f"{path} is over {_MAX_FILE} bytes: it should name a device a line"
            )
        lines = [line.strip() for line in text.decode("utf-8").splitlines()]
    except UnicodeDecodeError:
        raise TransportError(
            errno.EINVAL, f"{path} is not a text file: it should name a device a line"
        ) from None
    except TransportError:
        raise
    except OSError as error:
        raise TransportError(
            error.errno, f"{path}: {error.strerror}; it should name a device a line"
        ) from error
    devices = [line for line in lines if line and not line.startswith("#")]
    if not devices:
        raise TransportError(errno.EINVAL, f"{path} names no device: write one a line")
    return devices
