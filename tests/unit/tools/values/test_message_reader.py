from uros.interfaces import load
from uros.interfaces.codec import to_cdr
from uros.tools.values.message_reader import MessageReader

STRING = load("std_msgs/String")


def test_messages_are_read():
    assert MessageReader(STRING).read(to_cdr(STRING(data="a"))) == STRING(data="a")


def test_a_flood_of_broken_messages_has_few_warnings(capsys):
    reader = MessageReader(STRING)
    for _ in range(150):
        assert reader.read(b"\0\1\0\0\xff\0\0\0") is None
    lines = capsys.readouterr().err.splitlines()
    assert reader.unread == 150 and len(lines) == 3
    assert "100 messages could not be read" in lines[2] and "--raw prints the bytes" in lines[2]
