"""The host's check of USB descriptors, valid and invalid ones."""

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from uros.boards.virtual.hardware.usb_descriptors import (
    CONFIGURATION_DESCRIPTOR,
    DEVICE_DESCRIPTOR,
    STRINGS,
    DescriptorError,
    check_descriptors,
)

# The descriptors of the RA6M5, byte by byte.
DEVICE = bytes.fromhex("12 01 0002 02 00 00 40 5b04 1320 0002 01 02 03 01")
CONFIGURATION = bytes.fromhex(
    "09 02 4300 02 01 00 c0 32"
    "09 04 00 00 01 02 02 01 00  05 24 00 1001  05 24 01 00 01  04 24 02 02  05 24 06 00 01"
    "07 05 83 03 1000 ff"
    "09 04 01 00 02 0a 00 00 00  07 05 01 02 4000 00  07 05 82 02 4000 00"
)


def test_the_descriptors_of_the_ra6m5():
    assert DEVICE_DESCRIPTOR == DEVICE
    assert CONFIGURATION_DESCRIPTOR == CONFIGURATION and len(CONFIGURATION) == 67
    identity = check_descriptors(DEVICE, CONFIGURATION, STRINGS)
    assert (identity.vendor, identity.product) == (0x045B, 0x2013)
    assert (identity.manufacturer_name, identity.product_name, identity.serial) == (
        "Renesas", "RA6M5 Sensor Node", "000001",
    )  # fmt: skip
    assert identity.self_powered and identity.milliamperes == 100
    assert (identity.notification, identity.data_out, identity.data_in) == (0x83, 0x01, 0x82)


def test_strings_may_be_absent():
    device = DEVICE[:14] + b"\0\0\0" + DEVICE[17:]
    assert check_descriptors(device, CONFIGURATION, ()).serial == ""


def changed(data, **bytes_at):
    out = bytearray(data)
    for at, value in bytes_at.items():
        out[int(at[1:])] = value
    return bytes(out)


@pytest.mark.parametrize(
    "device, reason",
    [
        (b"", "0 bytes instead of 18"),
        (DEVICE + b"\0", "19 bytes"),
        (changed(DEVICE, _0=17), "says it has 17"),
        (changed(DEVICE, _1=2), "type is 2"),
        (changed(DEVICE, _4=3), "class 0x03"),
        (changed(DEVICE, _7=65), "packets of 65"),
        (changed(DEVICE, _14=4), "no string 4"),
        (changed(DEVICE, _17=0), "no configuration"),
    ],
)
def test_wrong_device_descriptors(device, reason):
    with pytest.raises(DescriptorError, match=reason):
        check_descriptors(device, CONFIGURATION, STRINGS)


def shorter(data, at):
    """Return ``data`` without the descriptor at ``at``, and with the total length corrected."""
    out = bytearray(data)
    del out[at : at + out[at]]
    struct.pack_into("<H", out, 2, len(out))
    return bytes(out)


@pytest.mark.parametrize(
    "configuration, reason",
    [
        (b"", "0 bytes"),
        (CONFIGURATION[:-1], "says 67 bytes and has 66"),
        (CONFIGURATION + b"\0", "says 67 bytes and has 68"),
        (changed(CONFIGURATION, _0=8), "begins with 8"),
        (changed(CONFIGURATION, _1=7), "begins with 9, 7"),
        (changed(CONFIGURATION, _4=3), "2 interfaces, it says 3"),
        (changed(CONFIGURATION, _5=0), "value is 0"),
        (changed(CONFIGURATION, _7=0x40), "bit 7"),
        (changed(CONFIGURATION, _8=251), "502 mA"),
        (changed(CONFIGURATION, _9=0), "a length of 0 at byte 9"),
        (changed(CONFIGURATION, _9=59), "a length of 59 at byte 9"),
        (changed(CONFIGURATION, _13=2), "interface 0: 1 endpoints"),
        (changed(CONFIGURATION, _14=3), "control"),
        (changed(CONFIGURATION, _34=1), "no union"),
        (changed(CONFIGURATION, _39=0x80), "0x80: no such address"),
        (changed(CONFIGURATION, _39=0x82), "0x82 is there twice"),
        (changed(CONFIGURATION, _39=0x03), "no interrupt endpoint"),
        (changed(CONFIGURATION, _41=65), "interrupt packets of 65"),
        (changed(CONFIGURATION, _43=0), "interval"),
        (changed(CONFIGURATION, _49=3), "needs a control"),
        (changed(CONFIGURATION, _57=63), "bulk packets of 63"),
        (changed(CONFIGURATION, _62=0x02), "one bulk endpoint in and one out"),
        (shorter(CONFIGURATION, 60), "interface 1: 1 endpoints"),
        (shorter(CONFIGURATION, 44), "1 interfaces"),
    ],
)
def test_wrong_configurations(configuration, reason):
    with pytest.raises(DescriptorError, match=reason):
        check_descriptors(DEVICE, configuration, STRINGS)


def test_a_string_that_is_too_long_is_refused():
    check_descriptors(DEVICE, CONFIGURATION, ("a", "b", "c" * 126))
    with pytest.raises(DescriptorError, match="too long"):
        check_descriptors(DEVICE, CONFIGURATION, ("a", "b", "c" * 127))


@given(st.binary(max_size=40), st.binary(max_size=90), st.lists(st.text(max_size=5)))
def test_any_bytes_are_accepted_or_refused_with_a_text(device, configuration, strings):
    for pair in ((device, configuration), (DEVICE, configuration), (device, CONFIGURATION)):
        try:
            check_descriptors(*pair, strings)
        except DescriptorError as error:
            assert str(error)


@given(st.integers(0, 66), st.integers(0, 255))
def test_any_changed_byte_is_accepted_or_refused_with_a_text(at, value):
    out = bytearray(CONFIGURATION)
    out[at] = value
    try:
        check_descriptors(DEVICE, bytes(out), STRINGS)
    except DescriptorError as error:
        assert str(error)
