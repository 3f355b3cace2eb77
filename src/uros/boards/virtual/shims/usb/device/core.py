# mypy: disable-error-code="no-any-return"
"""The USB device, its interfaces and their descriptors (USB 2.0, chapter 9.6)."""

import struct

import _board  # type: ignore[import-not-found]

_DEVICE = 1
_CONFIGURATION = 2
_INTERFACE = 4
_ENDPOINT = 5
_ASSOCIATION = 11
_KINDS = {"control": 0, "bulk": 2, "interrupt": 3}

# The defaults are those of MicroPython.
_VENDOR = 0xF055
_PRODUCT = 0x9802
_STRINGS = ("MicroPython", "Board in FS mode", "")
_EINVAL = 22

_device = None


def get() -> "Device":
    """Return the board's only USB device."""
    global _device
    if _device is None:
        _device = Device()
    return _device


class Device:
    """The USB device; use ``get()``."""

    def __init__(self) -> None:
        self._interfaces: tuple[Interface, ...] = ()
        self._descriptors: tuple[bytes, bytearray, list[str]] = (b"", bytearray(), [])
        self._active = False

    def init(self, *itfs: "Interface", **kwargs: object) -> None:
        """Configure the device and switch it on."""
        self.active(False)
        self.config(*itfs, **kwargs)  # type: ignore[arg-type]
        self.active(True)

    def active(self, *value: bool) -> bool:
        """Return whether the device is switched on; with a value, switch it.

        An interface's ``is_open()`` returns whether the host has configured it.
        """
        if value and bool(value[0]) != self._active:
            self._active = bool(value[0])
            if self._active:
                device, configuration, strings = self._descriptors
                _board.call(
                    _board.USB_ENABLE,
                    struct.pack("<H", len(device))
                    + device
                    + struct.pack("<H", len(configuration))
                    + configuration
                    + b"\0".join([text.encode() for text in strings]),
                )
            else:
                _board.call(_board.USB_DISABLE)
                for interface in self._interfaces:
                    interface.on_reset()
        return self._active

    def config(
        self,
        *itfs: "Interface",
        builtin_driver: bool = False,
        manufacturer_str: str | None = None,
        product_str: str | None = None,
        serial_str: str | None = None,
        configuration_str: str | None = None,
        id_vendor: int | None = None,
        id_product: int | None = None,
        bcd_device: int | None = None,
        device_class: int = 0,
        device_subclass: int = 0,
        device_protocol: int = 0,
        config_str: str | None = None,
        max_power_ma: int | None = None,
        remote_wakeup: bool = False,
    ) -> None:
        """Make the descriptors. The virtual board has no built-in driver to combine them with."""
        if self._active:
            raise OSError(_EINVAL)
        strings = [None, manufacturer_str, product_str, serial_str]
        device = struct.pack(
            "<BBHBBBBHHHBBBB",
            18,
            _DEVICE,
            0x0200,
            device_class,
            device_subclass,
            device_protocol,
            64,
            _VENDOR if id_vendor is None else id_vendor,
            _PRODUCT if id_product is None else id_product,
            0x0100 if bcd_device is None else bcd_device,
            1,
            2,
            3,
            1,
        )
        sizes = Descriptor(None)
        sizes.extend(bytes(9))
        for interface in itfs:
            interface.desc_cfg(sizes, 0, 0, [])
        configuration = bytearray(sizes.o)
        desc = Descriptor(configuration)
        desc.extend(bytes(9))
        interfaces, endpoints = 0, 1
        for interface in itfs:
            interface.desc_cfg(desc, interfaces, endpoints, strings)
            interfaces += interface.num_itfs()
            endpoints += interface.num_eps()
        number = 0
        if configuration_str:
            number = len(strings)
            strings.append(configuration_str)
        attributes = 0x80 | (0 if max_power_ma else 0x40) | (0x20 if remote_wakeup else 0)
        power = 125 if max_power_ma is None else max_power_ma // 2
        desc.pack_into(
            "<BBHBBBBB",
            0,
            9,
            _CONFIGURATION,
            len(configuration),
            interfaces,
            1,
            number,
            attributes,
            power,
        )
        texts = [text or "" for text in strings[1:]]
        for i in (0, 1, 2):
            if strings[i + 1] is None:
                texts[i] = _STRINGS[i]
        # Packed when they are needed: interfaces may still change their descriptors.
        self._descriptors = (device, configuration, texts)
        self._interfaces = itfs


class Interface:
    """One interface, or several that belong together. Drivers override its methods."""

    def __init__(self) -> None:
        self._open = False

    def desc_cfg(
        self, desc: "Descriptor", itf_num: int, ep_num: int, strs: "list[str | None]"
    ) -> None:
        """Write the descriptors; called twice, at first only for the length.

        Args:
            desc: Where to write them.
            itf_num: The first interface number.
            ep_num: The first endpoint number.
            strs: The strings, to which it may append.
        """
        raise NotImplementedError

    def num_itfs(self) -> int:
        """Return the number of interfaces."""
        return 1

    def num_eps(self) -> int:
        """Return the number of endpoint numbers."""
        return 0

    def on_open(self) -> None:
        """Handle the configuration of the device by the host."""
        self._open = True

    def on_reset(self) -> None:
        """Handle a reset by the host, or the removal of the cable."""
        self._open = False

    def is_open(self) -> bool:
        """Return whether the host has configured the device.

        ``on_open`` and ``on_reset`` run from here: a virtual board has no USB interrupts.
        """
        now = bool(_board.number(_board.USB_STATE) & _board.USB_OPEN)
        if now != self._open:
            if now:
                self.on_open()
            else:
                self.on_reset()
        return now


class Descriptor:
    """Descriptors, appended to ``b``; with None only their length ``o`` is counted."""

    def __init__(self, b: "bytearray | None") -> None:
        self.b = b
        self.o = 0

    def pack(self, fmt: str, *args: int) -> None:
        """Append packed values."""
        self.pack_into(fmt, self.o, *args)

    def pack_into(self, fmt: str, offs: int, *args: int) -> None:
        """Write packed values at an offset."""
        if self.b is not None:
            struct.pack_into(fmt, self.b, offs, *args)
        self.o = max(self.o, offs + struct.calcsize(fmt))

    def extend(self, a: bytes) -> None:
        """Append octets."""
        if self.b is not None:
            self.b[self.o : self.o + len(a)] = a
        self.o += len(a)

    def interface(
        self,
        bInterfaceNumber: int,
        bNumEndpoints: int,
        bInterfaceClass: int = 0xFF,
        bInterfaceSubClass: int = 0,
        bInterfaceProtocol: int = 0,
        iInterface: int = 0,
    ) -> None:
        """Append an interface descriptor (USB 2.0, 9.6.5)."""
        self.pack(
            "BBBBBBBBB",
            9,
            _INTERFACE,
            bInterfaceNumber,
            0,
            bNumEndpoints,
            bInterfaceClass,
            bInterfaceSubClass,
            bInterfaceProtocol,
            iInterface,
        )

    def endpoint(
        self,
        bEndpointAddress: int,
        bmAttributes: "int | str",
        wMaxPacketSize: int,
        bInterval: int = 1,
    ) -> None:
        """Append an endpoint descriptor (USB 2.0, 9.6.6).

        ``bmAttributes`` is a number, "control", "bulk" or "interrupt".
        """
        kind = _KINDS[bmAttributes] if isinstance(bmAttributes, str) else bmAttributes
        self.pack("<BBBBHB", 7, _ENDPOINT, bEndpointAddress, kind, wMaxPacketSize, bInterval)

    def interface_assoc(
        self,
        bFirstInterface: int,
        bInterfaceCount: int,
        bFunctionClass: int,
        bFunctionSubClass: int,
        bFunctionProtocol: int = 0,
        iFunction: int = 0,
    ) -> None:
        """Append an interface association descriptor (IAD)."""
        self.pack(
            "<BBBBBBBB",
            8,
            _ASSOCIATION,
            bFirstInterface,
            bInterfaceCount,
            bFunctionClass,
            bFunctionSubClass,
            bFunctionProtocol,
            iFunction,
        )
