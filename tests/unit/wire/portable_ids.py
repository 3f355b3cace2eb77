"""Numbers and their names. Also runs on MicroPython."""

from uros.wire import ids


def test_status_names() -> None:
    assert ids.status_name(0x00) == "OK"
    assert ids.status_name(0x01) == "OK_MATCHED"
    assert ids.status_name(0x80) == "ERR_DDS_ERROR"
    assert ids.status_name(0x87) == "ERR_RESOURCES"
    assert ids.status_name(0x88) == "0x88"
    assert ids.status_name(0x02) == "0x02"
    assert ids.status_name(0x7F) == "0x7F"


def test_flags_and_formats_do_not_overlap_with_the_byte_order() -> None:
    assert ids.FORMAT_MASK & ids.FLAG_LITTLE_ENDIAN == 0
    for form in (ids.FORMAT_SAMPLE, ids.FORMAT_DATA_SEQ, ids.FORMAT_SAMPLE_SEQ):
        assert form & ids.FORMAT_MASK == form
