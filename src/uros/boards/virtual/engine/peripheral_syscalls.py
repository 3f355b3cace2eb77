"""System calls for UARTs, SPI buses, WLAN and sockets."""

from __future__ import annotations

import errno
import select
import socket
import struct
from collections.abc import Callable
from typing import TYPE_CHECKING, Final

from ..shims import _ops as ops
from .advice import miswiring

if TYPE_CHECKING:
    from ..hardware.board import Interrupts, VirtualBoard
    from ..hardware.peripherals import Radio, Spi, Uart

_UART: Final = struct.Struct("<BII")
_UART_READ: Final = struct.Struct("<BH")
_SPI_READ: Final = struct.Struct("<BBH")
_CONNECT: Final = struct.Struct("<BH")
_RECV: Final = struct.Struct("<BH")
_WAIT: Final = struct.Struct("<IBB")
_UART_WAIT: Final = struct.Struct("<BHI")
_LONGEST_WAIT_US: Final = 1_000_000
INTERRUPT_US: Final = 2_000
"""The period at which a wait polls for interrupts, if the firmware has enabled any."""


class PeripheralHost:
    """Carries out the system calls for attached peripherals.

    Args:
        board: The virtual board.
        wait: Called when the firmware is about to wait for a socket.
        interrupts: The interrupts of the core.
        console: Called with what the board has to say to the author of the firmware.
    """

    def __init__(
        self, board: VirtualBoard, wait: Callable[[], None], interrupts: Interrupts,
        console: Callable[[str], None],
    ) -> None:  # fmt: skip
        self._board = board
        self._interrupts = interrupts
        self._wait = wait
        self._console = console
        self.operations: dict[int, Callable[[bytes], bytes | int]] = {
            ops.UART_INIT: self._uart_init,
            ops.UART_WRITE: lambda data: self._uart(data[0]).write(data[1:]),
            ops.UART_READ: self._uart_read,
            ops.UART_ANY: lambda data: self._uart(data[0]).any(),
            ops.UART_WAIT: self._uart_wait,
            ops.SPI_INIT: self._spi_init,
            ops.SPI_WRITE: self._spi_write,
            ops.SPI_READ: self._spi_read,
            ops.WLAN_CONNECT: self._connect,
            ops.WLAN_LEAVE: self._leave,
            ops.WLAN_STATUS: lambda _: self._radio().status(),
            ops.WLAN_START: self._start,
            ops.WLAN_STOP: self._stop,
            ops.WLAN_GUESTS: lambda _: self._radio().guests(),
            ops.NET_OPEN: lambda data: self._radio().open(data[0]),
            ops.NET_BIND: self._net_bind,
            ops.NET_CONNECT: self._net_connect,
            ops.NET_SEND: lambda data: self._radio().of(data[0]).send(data[1:]),
            ops.NET_RECV: self._net_recv,
            ops.NET_CLOSE: self._net_close,
            ops.NET_WAIT: self._net_wait,
        }

    def _uart(self, number: int) -> Uart:
        return self._board.uarts[number]

    def _uart_init(self, data: bytes) -> bytes:
        number, baud, rxbuf = _UART.unpack_from(data)
        tx, _, rx = data[_UART.size :].decode().partition("\0")
        uart = self._uart(number)
        uart.init(baud, rxbuf, tx, rx)
        if text := miswiring(self._board, number):
            self._console(text + "\n")
        return b""

    def _uart_read(self, data: bytes) -> bytes:
        number, size = _UART_READ.unpack(data)
        return self._uart(number).read(size)

    def _uart_wait(self, data: bytes) -> bytes:
        number, size, us = _UART_WAIT.unpack(data)
        uart, board, interrupts = self._uart(number), self._board, self._interrupts
        self._wait()
        end = board.clock.world_us() + us
        while True:
            board.advance()
            ready, left = uart.any(), end - board.clock.world_us()
            # Not after the first octet of a frame: each return costs the host time.
            if ready and not uart.under_way() or left <= 0 or interrupts.due:
                return uart.read(size)
            uart.pause(min(left, INTERRUPT_US) if interrupts.wanted else left)

    def _spi(self, number: int) -> Spi:
        return self._board.spis[number]

    def _spi_init(self, data: bytes) -> bytes:
        self._spi(data[0]).init(data[1])
        return b""

    def _spi_write(self, data: bytes) -> bytes:
        self._spi(data[0]).write(data[1:])
        return b""

    def _spi_read(self, data: bytes) -> bytes:
        number, octet, count = _SPI_READ.unpack(data)
        return self._spi(number).read(count, octet)

    def _radio(self) -> Radio:
        radio = self._board.radio
        if radio is None:
            raise OSError(errno.ENODEV, "this board has no radio")
        return radio

    def _connect(self, data: bytes) -> bytes:
        ssid, _, password = data.decode().partition("\0")
        self._radio().connect(ssid, password)
        return b""

    def _start(self, data: bytes) -> bytes:
        ssid, password, _ = data.decode().split("\0")
        self._radio().start(ssid, password)
        return b""

    def _stop(self, data: bytes) -> bytes:
        self._radio().stop()
        return b""

    def _leave(self, data: bytes) -> bytes:
        self._radio().disconnect()
        return b""

    def _net_bind(self, data: bytes) -> bytes:
        self._radio().bind(*_CONNECT.unpack(data))
        return b""

    def _net_connect(self, data: bytes) -> bytes:
        handle, port = _CONNECT.unpack_from(data)
        try:
            self._radio().connect_socket(handle, data[_CONNECT.size :].decode(), port)
        except socket.gaierror as error:
            raise OSError(errno.EHOSTUNREACH, str(error)) from error
        return b""

    def _net_recv(self, data: bytes) -> bytes:
        handle, size = _RECV.unpack(data)
        return self._radio().of(handle).recv(size)

    def _net_close(self, data: bytes) -> bytes:
        self._radio().close(data[0])
        return b""

    def _net_wait(self, data: bytes) -> int:
        us, handle, events = _WAIT.unpack(data)
        fd = self._radio().fd(handle)
        if fd < 0:
            return select.POLLERR
        if us:
            self._wait()
        poll = select.poll()
        poll.register(fd, events)
        if self._interrupts.wanted:
            us = min(us, INTERRUPT_US)
        ready = poll.poll(self._board.clock.host_seconds(min(us, _LONGEST_WAIT_US)) * 1000)
        return ready[0][1] & 0x1F if ready else 0
