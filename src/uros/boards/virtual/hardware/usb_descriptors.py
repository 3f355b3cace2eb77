"""USB descriptors of a serial port (CDC-ACM), and what a host checks in them."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

PACKET: Final = 64  # the largest of a full-speed device

# Descriptor types, classes, kinds of endpoints.
_DEVICE, _CONFIGURATION, _INTERFACE, _ENDPOINT, _CS_INTERFACE = 1, 2, 4, 5, 0x24
_COMMUNICATION, _DATA, _MISCELLANEOUS = 0x02, 0x0A, 0xEF
_ACM: Final = 0x02
_UNION: Final = 0x06
_BULK, _INTERRUPT = 2, 3
_IN: Final = 0x80
_PACKET_SIZES: Final = (8, 16, 32, 64)


class DescriptorError(ValueError):
    """Descriptors that a host does not accept; the text has the reason."""


@dataclass(frozen=True)
class UsbIdentity:
    """Contents of the descriptors of a USB serial port."""

    vendor: int
    product: int
    manufacturer_name: str
    product_name: str
    serial: str
    self_powered: bool
    milliamperes: int
    notification: int  # addresses of the endpoints
    data_out: int
    data_in: int


def device_descriptor(vendor: int, product: int, device_class: int = _COMMUNICATION) -> bytes:
    """Return a device descriptor: USB 2.0, one configuration, 3 strings.

    Strings 1 to 3 are manufacturer, product and serial number.
    """
    return struct.pack(
        "<BBHBBBBHHHBBBB",
        18, _DEVICE, 0x0200, device_class, 0, 0, PACKET, vendor, product, 0x0200, 1, 2, 3, 1,
    )  # fmt: skip


def cdc_configuration(notification: int, data_out: int, data_in: int, milliamperes: int) -> bytes:
    """Return the configuration of a self-powered serial port (CDC-ACM).

    It has a control and a data interface.
    """
    body = b"".join(
        (
            struct.pack("9B", 9, _INTERFACE, 0, 0, 1, _COMMUNICATION, _ACM, 1, 0),
            struct.pack("<BBBH", 5, _CS_INTERFACE, 0x00, 0x0110),  # header: CDC 1.10
            struct.pack("5B", 5, _CS_INTERFACE, 0x01, 0, 1),  # call management
            struct.pack("4B", 4, _CS_INTERFACE, _ACM, 2),  # line coding and state
            struct.pack("5B", 5, _CS_INTERFACE, _UNION, 0, 1),
            struct.pack("<BBBBHB", 7, _ENDPOINT, notification, _INTERRUPT, 16, 255),
            struct.pack("9B", 9, _INTERFACE, 1, 0, 2, _DATA, 0, 0, 0),
            struct.pack("<BBBBHB", 7, _ENDPOINT, data_out, _BULK, PACKET, 0),
            struct.pack("<BBBBHB", 7, _ENDPOINT, data_in, _BULK, PACKET, 0),
        )
    )
    head = struct.pack(
        "<BBHBBBBB", 9, _CONFIGURATION, 9 + len(body), 2, 1, 0, 0xC0, milliamperes // 2
    )
    return head + body


DEVICE_DESCRIPTOR: Final = device_descriptor(0x045B, 0x2013)
CONFIGURATION_DESCRIPTOR: Final = cdc_configuration(0x83, 0x01, 0x82, 100)
STRINGS: Final = ("Renesas", "RA6M5 Sensor Node", "000001")


def _require(condition: bool, reason: str) -> None:
    if not condition:
        raise DescriptorError(reason)


def check_descriptors(device: bytes, configuration: bytes, strings: Sequence[str]) -> UsbIdentity:
    """Check the descriptors of a full-speed CDC-ACM device, as a host does.

    Args:
        device: Device descriptor.
        configuration: Configuration descriptor with all that follows it.
        strings: String descriptors; ``strings[0]`` has index 1.

    Raises:
        DescriptorError: A host does not accept the descriptors.
    """
    _require(len(device) == 18, f"device descriptor: {len(device)} bytes instead of 18")
    _require(device[0] == 18, f"device descriptor: it says it has {device[0]} bytes, not 18")
    _require(device[1] == _DEVICE, f"device descriptor: its type is {device[1]}, not {_DEVICE}")
    _, _, _, kind, _, _, packet, vendor, product, _, *indexes, configurations = struct.unpack(
        "<BBHBBBBHHHBBBB", device
    )
    _require(packet in _PACKET_SIZES, f"device descriptor: packets of {packet} bytes")
    _require(configurations >= 1, "device descriptor: no configuration")
    _require(
        kind in (0, _COMMUNICATION, _MISCELLANEOUS),
        f"device descriptor: class 0x{kind:02x} is not that of a serial port",
    )
    for text in strings:
        _require(len(text.encode("utf-16-le")) <= 252, f"string {text[:20]!r}… is too long")
    names = []
    for index in indexes:
        _require(index <= len(strings), f"device descriptor: there is no string {index}")
        names.append(strings[index - 1] if index else "")
    maker, name, serial = names
    attributes, power, (notification, data_out, data_in) = _check_configuration(configuration)
    return UsbIdentity(
        vendor=vendor,
        product=product,
        manufacturer_name=maker,
        product_name=name,
        serial=serial,
        self_powered=bool(attributes & 0x40),
        milliamperes=2 * power,
        notification=notification,
        data_out=data_out,
        data_in=data_in,
    )


@dataclass
class _Interface:
    number: int
    kind: int
    subclass: int
    announced: int  # number of endpoints
    endpoints: list[tuple[int, int]]  # address, kind
    has_union: bool = False


def _check_configuration(data: bytes) -> tuple[int, int, tuple[int, int, int]]:
    """Return attributes, power in 2 mA, and the endpoints for notifications, out and in."""
    where = "configuration descriptor"
    _require(len(data) >= 9, f"{where}: {len(data)} bytes, fewer than its head has")
    length, kind, total, count, value, _, attributes, power = struct.unpack_from("<BBHBBBBB", data)
    _require(length == 9 and kind == _CONFIGURATION, f"{where}: it begins with {length}, {kind}")
    _require(total == len(data), f"{where}: it says {total} bytes and has {len(data)}")
    _require(value != 0, f"{where}: its value is 0, which means unconfigured")
    _require(bool(attributes & 0x80), f"{where}: bit 7 of the attributes is not set")
    _require(power <= 250, f"{where}: {2 * power} mA is more than a port gives")
    interfaces: list[_Interface] = []
    at = 9
    while at < total:
        length = data[at]
        _require(2 <= length <= total - at, f"{where}: a length of {length} at byte {at}")
        body = data[at : at + length]
        if body[1] == _INTERFACE:
            _require(length == 9, f"{where}: an interface of {length} bytes at byte {at}")
            if body[3] == 0:
                interfaces.append(_Interface(body[2], body[5], body[6], body[4], []))
        elif body[1] == _ENDPOINT:
            _require(length == 7, f"{where}: an endpoint of {length} bytes at byte {at}")
            _require(bool(interfaces), f"{where}: an endpoint before any interface")
            interfaces[-1].endpoints.append(_check_endpoint(body, interfaces))
        elif body[1] == _CS_INTERFACE and interfaces and length >= 5 and body[2] == _UNION:
            interfaces[-1].has_union = True
        at += length
    return attributes, power, _serial_port(count, interfaces)


def _check_endpoint(body: bytes, interfaces: list[_Interface]) -> tuple[int, int]:
    address, kind, size, interval = struct.unpack("<BBHB", body[2:])
    kind &= 3
    name = f"endpoint 0x{address:02x}"
    _require(address & 0x0F != 0 and not address & 0x70, f"{name}: no such address")
    taken = [endpoint for interface in interfaces for endpoint, _ in interface.endpoints]
    _require(address not in taken, f"{name} is there twice")
    if kind == _BULK:
        _require(size in _PACKET_SIZES, f"{name}: bulk packets of {size} bytes")
    if kind == _INTERRUPT:
        _require(1 <= size <= PACKET, f"{name}: interrupt packets of {size} bytes")
        _require(interval > 0, f"{name}: an interval of 0 ms")
    return address, kind


def _serial_port(count: int, interfaces: list[_Interface]) -> tuple[int, int, int]:
    have = len(interfaces)
    _require(have == count, f"configuration descriptor: {have} interfaces, it says {count}")
    for interface in interfaces:
        have = len(interface.endpoints)
        _require(
            have == interface.announced,
            f"interface {interface.number}: {have} endpoints, not as it says",
        )
    control = next(
        (
            interface
            for interface in interfaces
            if (interface.kind, interface.subclass) == (_COMMUNICATION, _ACM)
        ),
        None,
    )
    data = next((interface for interface in interfaces if interface.kind == _DATA), None)
    if control is None or data is None:
        raise DescriptorError("no serial port: it needs a control (2, 2) and a data interface (10)")
    _require(control.has_union, f"interface {control.number}: no union with the data interface")
    notify = [end for end, kind in control.endpoints if kind == _INTERRUPT and end & _IN]
    incoming = [end for end, kind in data.endpoints if kind == _BULK and end & _IN]
    outgoing = [end for end, kind in data.endpoints if kind == _BULK and not end & _IN]
    _require(len(notify) == 1, f"interface {control.number}: no interrupt endpoint in")
    _require(
        len(incoming) == 1 and len(outgoing) == 1,
        f"interface {data.number}: not one bulk endpoint in and one out",
    )
    return notify[0], outgoing[0], incoming[0]
