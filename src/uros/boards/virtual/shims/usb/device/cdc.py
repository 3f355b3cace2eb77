# mypy: disable-error-code="no-any-return"
"""A serial port over USB (CDC 1.20, PSTN 1.20), read and written like a ``machine.UART``."""

import io
import struct

import _board  # type: ignore[import-not-found]

from .core import Interface

try:
    from typing import Any
except ImportError:
    pass

_STREAM_FLUSH = 1
_STREAM_POLL = 3
_POLLIN = 1
_POLLOUT = 4
_POLLHUP = 16
_EINVAL = -22

_PARITIES = "NOEMS"
_STOPS = ("1", "1.5", "2")


class CDCInterface(io.IOBase, Interface):
    """A CDC ACM interface. Reads and writes wait up to ``timeout`` ms for the requested octets.

    ``read`` and ``readinto`` return None when nothing was received, ``write`` the number of octets
    that were taken. The attributes ``ep_c_in``, ``ep_d_in`` and ``ep_d_out`` are the endpoints; a
    subclass may write other descriptors in ``desc_cfg``.
    """

    def __init__(self, **kwargs: object) -> None:
        Interface.__init__(self)
        self.break_cb: Any = None
        self.line_state_cb: Any = None
        self.line_coding_cb: Any = None
        self.ep_c_in: int | None = None
        self.ep_d_in: int | None = None
        self.ep_d_out: int | None = None
        self._c_itf: int | None = None
        self._line_coding = bytearray(7)
        self.init(**kwargs)  # type: ignore[arg-type]

    def init(
        self,
        baudrate: int = 9600,
        bits: int = 8,
        parity: str = "N",
        stop: "int | str" = 1,
        timeout: int = 1000,
        txbuf: int = 256,
        rxbuf: int = 256,
        flow: int = 0,
    ) -> None:
        """Set the line coding, which is only reported to the host, and the timeout in ms."""
        struct.pack_into(
            "<LBBB",
            self._line_coding,
            0,
            baudrate,
            _STOPS.index(str(stop)),
            _PARITIES.index(parity),
            bits,
        )
        if flow != 0:
            raise NotImplementedError
        if not (txbuf and rxbuf >= 64):
            raise ValueError
        self._timeout = timeout

    @property
    def rts(self) -> bool:
        """The same as ``dtr``."""
        return self.dtr

    @property
    def dtr(self) -> bool:
        """Whether a program on the host has opened the port."""
        return bool(_board.number(_board.USB_STATE) & _board.USB_DTR)

    @property
    def baudrate(self) -> int:
        """The baud rate of the line coding."""
        return struct.unpack("<LBBB", self._line_coding)[0]

    @property
    def stop_bits(self) -> str:
        """The stop bits of the line coding: 1, 1.5 or 2."""
        return _STOPS[self._line_coding[4]]

    @property
    def parity(self) -> str:
        """The parity of the line coding: N, O, E, M or S."""
        return _PARITIES[self._line_coding[5]]

    @property
    def data_bits(self) -> int:
        """The data bits of the line coding."""
        return self._line_coding[6]

    def set_break_cb(self, cb: "Any") -> None:
        """Set the callback for a break."""
        self.break_cb = cb

    def set_line_state_cb(self, cb: "Any") -> None:
        """Set the callback for the control line state."""
        self.line_state_cb = cb

    def set_line_coding_cb(self, cb: "Any") -> None:
        """Set the callback for the line coding."""
        self.line_coding_cb = cb

    # --- descriptors -------------------------------------------------------------------

    def desc_cfg(self, desc: "Any", itf_num: int, ep_num: int, strs: "Any") -> None:
        """Write the descriptors of both interfaces and their endpoints."""
        desc.interface_assoc(itf_num, 2, 2, 2)
        self._c_itf = itf_num
        desc.interface(itf_num, 1, 2, 2)
        for fmt, values in (
            ("<BBBH", (5, 0x24, 0, 0x0120)),  # header: CDC 1.20
            ("<BBBBB", (5, 0x24, 1, 0, itf_num + 1)),  # call management: none
            ("<BBBB", (4, 0x24, 2, 6)),  # abstract control: line coding and state, break
            ("<BBBBB", (5, 0x24, 6, itf_num, itf_num + 1)),  # union
        ):
            desc.pack(fmt, *values)
        self.ep_c_in = ep_num | 0x80
        desc.endpoint(self.ep_c_in, "interrupt", 8, 16)
        desc.interface(itf_num + 1, 2, 10, 0, 0)
        self.ep_d_out = ep_num + 1
        self.ep_d_in = (ep_num + 1) | 0x80
        desc.endpoint(self.ep_d_out, "bulk", 64, 0)
        desc.endpoint(self.ep_d_in, "bulk", 64, 0)

    def num_itfs(self) -> int:
        """Return the number of interfaces."""
        return 2

    def num_eps(self) -> int:
        """Return the number of endpoint numbers."""
        return 2

    # --- the stream --------------------------------------------------------------------

    def write(self, buf: bytes) -> int:
        """Write octets; return how many were taken within the timeout."""
        done: int = _board.number(_board.USB_WRITE, buf)
        if done < len(buf) and self._timeout > 0:
            view = memoryview(buf)
            start = _board.number(_board.TICKS_US)
            while done < len(buf):
                past = (_board.number(_board.TICKS_US) - start) & 0x3FFFFFFF
                if past >= self._timeout * 1000:
                    break
                # There is no event for the host's reads: try again.
                _board.call(_board.SLEEP, struct.pack("<Q", 1000))
                done += _board.number(_board.USB_WRITE, view[done:])
        return done

    def read(self, size: int = -1) -> "bytes | None":
        """Return octets received within the timeout, None when there are none."""
        if size < 0:
            size = _board.number(_board.USB_ANY)
        data: bytes = _board.call(_board.USB_READ, struct.pack("<H", min(size, 65535)))
        if len(data) < size and self._timeout > 0:
            start = _board.number(_board.TICKS_US)
            while len(data) < size:
                past = (_board.number(_board.TICKS_US) - start) & 0x3FFFFFFF
                left = self._timeout * 1000 - past
                if left <= 0:
                    break
                wait = struct.pack("<IB", min(left, 1000000), _board.USB_READABLE)
                _board.number(_board.USB_WAIT, wait)
                want = struct.pack("<H", min(size - len(data), 65535))
                data += _board.call(_board.USB_READ, want)
        return data or None

    def readinto(self, b: bytearray) -> "int | None":
        """Fill a buffer with octets received; return their number, None when there are none."""
        data = self.read(len(b))
        if data is None:
            return None if len(b) else 0
        b[: len(data)] = data
        return len(data)

    def ioctl(self, req: int, arg: int) -> int:
        """Answer MicroPython's stream requests: poll and flush."""
        if req == _STREAM_POLL:
            state = _board.number(_board.USB_STATE)
            events = 0
            if state & _board.USB_READABLE:
                events |= _POLLIN
            if state & _board.USB_WRITABLE:
                events |= _POLLOUT
            if state & _board.USB_CLOSED:
                events |= _POLLHUP
            return events & arg
        if req == _STREAM_FLUSH:
            return 0  # octets that were taken are on the line
        return _EINVAL

    def flush(self) -> None:
        """Wait until all octets are sent; does nothing here: those taken are on the line."""
