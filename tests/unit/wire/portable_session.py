"""Payloads of the session's submessages, byte by byte, both ways. Also runs on MicroPython.

"recorded": cut from the conversations in tests/captures, by the name of the file.
"by hand": written from the order and sizes of the fields in XRCE 8.3.5 and the C sources.
"""

from support.portable import pair, reader, refused

from uros.wire import ids, session
from uros.wire.cdr import Writer
from uros.wire.errors import DecodeError, EncodeError, LimitError


def test_create_client() -> None:
    pair(  # recorded: publish_reliable, client
        "58524345 0100 010f aaaabbbb 81 00 fc01",
        session.push_create_client,
        session.pull_create_client,
        (b"XRCE", (1, 0), b"\x01\x0f", 0xAAAABBBB, 0x81, [], 508),
        (0xAAAABBBB, 0x81, 508),
    )


def test_create_client_with_properties() -> None:
    pair(  # by hand: what a client with hard liveliness sends
        "58524345 0100 010f 01020304 81 01 0000"
        "01000000 07000000 7578725f686c00 00 03000000 313000 00 0002",
        session.push_create_client,
        session.pull_create_client,
        (b"XRCE", (1, 0), b"\x01\x0f", 0x01020304, 0x81, [("uxr_hl", "10")], 512),
        (0x01020304, 0x81, 512, [("uxr_hl", "10")]),
    )


def test_create_client_big_endian() -> None:
    octets = bytes.fromhex("58524345 0100 010f aaaabbbb 81 00 01fc")
    assert session.pull_create_client(reader(octets, False))[6] == 508


def test_create_client_with_too_many_properties() -> None:
    head = bytes.fromhex("58524345 0100 010f aaaabbbb 81 01 0000")
    for count in (b"\x21\x00\x00\x00", b"\xff\xff\xff\xff"):
        refused(LimitError, session.pull_create_client, reader(head + count))
    # 32 properties are allowed, so the bytes are missing.
    refused(DecodeError, session.pull_create_client, reader(head + b"\x20\x00\x00\x00"))


def test_create_client_with_a_flag_that_is_neither_0_nor_1() -> None:
    octets = bytes.fromhex("58524345 0100 010f aaaabbbb 81 02 fc01")
    assert "boolean" in refused(DecodeError, session.pull_create_client, reader(octets))


def test_create_client_values_that_do_not_fit() -> None:
    for key, number, mtu, more in (
        (1 << 32, 0x81, 508, {}),
        (-1, 0x81, 508, {}),
        (1, 256, 508, {}),
        (1, 0x81, 65536, {}),
        (1, 0x81, -1, {}),
        (1, 0x81, 508, {"vendor": b"\x01"}),
        (1, 0x81, 508, {"cookie": b"XRC"}),
        (1, 0x81, 508, {"version": (1, 256)}),
    ):
        try:
            session.push_create_client(Writer(bytearray(64)), key, number, mtu, **more)
        except EncodeError:
            continue
        raise AssertionError((key, number, mtu, more))


def test_status_agent() -> None:
    pair(  # recorded: publish_reliable, agent
        "0000 58524345 0100 010f 00",
        session.push_status_agent,
        session.pull_status_agent,
        (0, 0),
    )
    octets = bytes.fromhex("8001 58524345 0100 010f 00")
    assert session.pull_status_agent(reader(octets)) == (0x80, 1)


def test_status_agent_with_properties() -> None:
    octets = bytes.fromhex("0000 58524345 0100 010f 01 00 01000000 02000000 6100 0000 01000000 00")
    r = reader(octets)
    assert session.pull_status_agent(r) == (0, 0)
    assert r.remaining() == 0
    octets = bytes.fromhex("0000 58524345 0100 010f 01 00 21000000")
    refused(LimitError, session.pull_status_agent, reader(octets))


def test_status_agent_of_something_else() -> None:
    octets = bytes.fromhex("0000 58524346 0100 010f 00")
    assert "XRCE" in refused(DecodeError, session.pull_status_agent, reader(octets))


def test_delete() -> None:
    pair(  # recorded: serial_publish, client: the session itself
        "0002 fffe", session.push_request, session.pull_request, (2, ids.OBJECT_CLIENT)
    )


def test_status() -> None:
    pair(  # recorded: publish_reliable, agent
        "000a 0011 00 00", session.push_status, session.pull_status, (10, 0x11, 0, 0)
    )
    pair(  # recorded: serial_publish, agent: the answer to the session's end
        "0002 fffe 00 00", session.push_status, session.pull_status, (2, 0xFFFE, 0, 0)
    )
    pair(  # by hand
        "ffff 0125 84 07", session.push_status, session.pull_status, (0xFFFF, 0x125, 0x84, 7)
    )


def test_get_info() -> None:
    pair(  # recorded: ping, client
        "000a fffd 02000000",
        session.push_get_info,
        session.pull_get_info,
        (10, ids.OBJECT_AGENT, ids.INFO_ACTIVITY),
    )


def test_info() -> None:
    pair(  # recorded: ping, agent, without a session
        "000a fffd 00 00 01 0d 58524345 0100 010f 00 01 0d 00 0100 0000 00000000",
        session.push_info,
        session.pull_info,
        (10, 0xFFFD, 0, 0, []),
    )
    pair(  # recorded: ping, agent, within a session
        "000a fffd 00 01 01 0d 58524345 0100 010f 00 01 0d 00 0100 0000 00000000",
        session.push_info,
        session.pull_info,
        (10, 0xFFFD, 0, 1, []),
    )


def test_info_with_locators() -> None:
    pair(  # by hand
        "0001 fffd 00 00 01 0d 58524345 0100 010f 00 01 0d 00 0100 0000 02000000"
        "01 7f000001 00 b822 01 c0a80001 00 b922",
        session.push_info,
        session.pull_info,
        (1, 0xFFFD, 0, 0, [(b"\x7f\0\0\x01", 8888), (b"\xc0\xa8\0\x01", 8889)]),
    )
    pair(  # by hand
        "0001 fffd 00 00 01 0d 58524345 0100 010f 00 01 0d 00 0100 0000 02000000"
        "02 20010db8000000000000000000000001 000000 b8220000 01 c0a80001 00 b922",
        session.push_info,
        session.pull_info,
        (1, 0xFFFD, 0, 0, [
            (b"\x20\x01\x0d\xb8" + bytes(11) + b"\x01", 8888), (b"\xc0\xa8\0\x01", 8889),
        ]),
    )  # fmt: skip
    w = Writer(bytearray(99))
    refused(EncodeError, session.push_info, w, 1, 0xFFFD, 0, 0, [(b"\x7f\0\x01", 8888)])
    w = Writer(bytearray(99))
    refused(EncodeError, session.push_info, w, 1, 0xFFFD, 0, 0, [(b"\x7f\0\0\x01", 65536)])


def test_info_with_locators_of_every_format() -> None:
    octets = bytes.fromhex(  # by hand
        "0001 fffd 00 00 00 01 0d 00 0100 04000000"
        "00 0a0b 16 01 7f000001 00 b822"
        "02 20202020202020202020202020202020 000000 b8220000"
        "03 000000 03000000 616200"
    )
    r = reader(octets)
    locators = [(b"\x7f\0\0\x01", 8888), (b" " * 16, 8888)]
    assert session.pull_info(r) == (1, 0xFFFD, 0, 0, locators)
    assert r.remaining() == 0


def test_info_without_anything() -> None:
    assert session.pull_info(reader(bytes.fromhex("0001 fffd 83 00 00 00"))) == (
        (1, 0xFFFD, 0x83, 0, [])
    )


def test_invalid_info_is_refused() -> None:
    head = "0001 fffd 00 00 "
    invalid_info = reader(bytes.fromhex(head + "01 0e"))
    assert "not the agent" in refused(DecodeError, session.pull_info, invalid_info)
    form = reader(bytes.fromhex(head + "00 01 0d 00 0100 01000000 04"))
    assert "format 4" in refused(DecodeError, session.pull_info, form)
    many = reader(bytes.fromhex(head + "00 01 0d 00 0100 41000000"))
    refused(LimitError, session.pull_info, many)


def test_acknack() -> None:
    pair(  # recorded: publish_reliable, client
        "0100 0000 80", session.push_acknack, session.pull_acknack, (1, 0, 0x80)
    )
    # by hand from the C sources: the bitmap is two octets, those of the later eight first
    pair("feff 8001 81", session.push_acknack, session.pull_acknack, (0xFFFE, 0x8001, 0x81))


def test_heartbeat() -> None:
    pair(  # recorded: service, agent
        "0600 0600 80", session.push_heartbeat, session.pull_heartbeat, (6, 6, 0x80)
    )
    pair(  # by hand
        "ffff 0e00 ff", session.push_heartbeat, session.pull_heartbeat, (0xFFFF, 14, 0xFF)
    )


def test_acknack_message() -> None:
    # recorded: rclc_int32_publisher
    recorded = bytes.fromhex("810000000a0105000100000080")
    assert session.acknack_message(0x81, 0x4B0CBE99, 1, 0, 0x80) == recorded
    # by hand: a session id with the key in the header, numbers that use both octets
    by_hand = bytes.fromhex("010000004b0cbe99 0a010500 fffe 8001 ff")
    assert session.acknack_message(0x01, 0x4B0CBE99, 0xFEFF, 0x8001, 0xFF) == by_hand


def test_acknack_and_heartbeat_that_do_not_fit() -> None:
    for push in (session.push_acknack, session.push_heartbeat):
        for values in ((0x10000, 0, 0), (0, 0x10000, 0), (0, 0, 256), (-1, 0, 0), (0, -1, 0)):
            refused(EncodeError, push, Writer(bytearray(9)), *values)


def test_timestamp() -> None:
    pair(  # recorded: rclc_time_sync, client
        "4ce6016b 104e4938",
        session.push_timestamp,
        session.pull_timestamp,
        (1795286604, 944328208),
    )
    refused(EncodeError, session.push_timestamp, Writer(bytearray(8)), 1 << 32, 0)
    refused(EncodeError, session.push_timestamp, Writer(bytearray(8)), -1, 0)


def test_timestamp_reply() -> None:
    pair(  # recorded: rclc_time_sync, agent
        "4ce6016b280a4b38 4ce6016b17064b38 4ce6016b104e4938",
        session.push_timestamp_reply,
        session.pull_timestamp_reply,
        ((1795286604, 944441896), (1795286604, 944440855), (1795286604, 944328208)),
    )


def test_big_endian_peers() -> None:  # by hand
    assert session.pull_acknack(reader(b"\x00\x01\x80\x00\x80", False)) == (1, 0x8000, 0x80)
    assert session.pull_heartbeat(reader(b"\x00\x01\x00\x02\x80", False)) == (1, 2, 0x80)
    octets = bytes.fromhex("000a fffd 00000002")
    assert session.pull_get_info(reader(octets, False)) == (10, 0xFFFD, 2)
    octets = bytes.fromhex("6b01e64c 38494e10")
    assert session.pull_timestamp(reader(octets, False)) == (1795286604, 944328208)
