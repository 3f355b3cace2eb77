"""Lines of gains, as a rover receives them over TCP. Also runs on MicroPython."""

from uros.drivers.pid_line import MAX_LINE, PidLine, format_gains, format_sample, parse_gains

DOCUMENT = "200,30,5,200,30,5,1.0,0"
VALUES = (200, 30, 5, 200, 30, 5, 1, 0)
BACK = "0.5,0,0,40.25,0,1,-0.3,-1"
BACK_VALUES = (0.5, 0, 0, 40.25, 0, 1, -0.3, -1)


def refused(text):
    try:
        values = parse_gains(text)
    except ValueError as error:
        return str(error)
    raise AssertionError("%r gave %r" % (text, values))


def near(values, wanted):
    assert len(values) == len(wanted), (values, wanted)
    for value, expected in zip(values, wanted):
        assert abs(value - expected) < 1e-6, (values, wanted)


def commands(*pieces):
    """Return the commands in the pieces; None is a pause."""
    line = PidLine()
    parsed = []
    for piece in pieces:
        parsed += line.flush() if piece is None else line.feed(piece.encode())
    assert not line.faults, line.fault
    return parsed


def test_the_line_of_the_document():
    near(parse_gains(DOCUMENT), VALUES)
    near(parse_gains(" 200, 30,5 ,200,30,5,1.0,0\r\n"), VALUES)
    near(parse_gains(BACK), BACK_VALUES)
    assert type(parse_gains(DOCUMENT)[7]) is int


def test_faults_name_the_wrong_value():
    assert refused("") == (
        "1 value instead of 8: R_Kp,R_Ki,R_Kd,L_Kp,L_Ki,L_Kd,speed,rot"
    )  # fmt: skip
    assert refused("1,2").startswith("2 values instead of 8")
    assert refused(DOCUMENT + ",").startswith("9 values")
    assert refused("200,,5,200,30,5,1.0,0") == "R_Ki is missing, which is no number"
    assert refused("200,30,x,200,30,5,1.0,0") == "R_Kd is x, which is no number"
    assert refused("200,30,5,-1,30,5,1.0,0") == "L_Kp is -1: a gain is 0 to 10000"
    assert refused("200,30,5,1,30,10001,1.0,0").startswith("L_Kd is 10001")
    assert refused("200,30,5,200,30,5,5.5,0").startswith("speed is 5.5 m/s: at most 5")
    assert refused("200,30,5,200,30,5,1.0,2") == (
        "rot is 2: 1 counter-clockwise, -1 clockwise, 0 none"
    )
    assert refused("200,30,5,200,30,5,1.0,0.5").startswith("rot is 0.5")


def test_only_decimal_numbers_are_accepted():
    for word in (
        "nan",
        "inf",
        "-inf",
        "1e3",
        "1_0",
        "0x10",
        "--1",
        ".",
        "-",
        "-.",
        "1-",
        "1.2.3",
        "",
        "\u0663",
    ):
        assert refused("200,30,5,200,30,5,%s,0" % word).startswith("speed is ")


def test_formatted_lines_are_parsed():
    assert format_gains(VALUES) == "200,30,5,200,30,5,1,0"
    near(parse_gains(format_gains(BACK_VALUES)), BACK_VALUES)
    assert format_sample((113.4, -87.6, 301.0)) == "113,-88,301"


def test_every_line_end_is_accepted():
    for end in ("\n", "\r\n", ";", "\0", "\n\n"):
        parsed = commands(DOCUMENT + end + BACK + end)
        near(parsed[0], VALUES)
        near(parsed[1], BACK_VALUES)
        assert len(parsed) == 2


def test_lines_cut_at_any_point():
    text = DOCUMENT + "\n" + BACK + "\n"
    for at in range(len(text)):
        assert len(commands(text[:at], text[at:])) == 2
    assert len(commands(*text)) == 2


def test_a_pause_ends_a_line():
    line = PidLine()
    assert line.feed(DOCUMENT.encode()) == []
    near(line.flush()[0], VALUES)
    assert line.flush() == []
    assert len(commands(DOCUMENT, None, BACK, None, DOCUMENT, None)) == 3


def test_lines_joined_without_a_line_end():
    text = DOCUMENT + BACK + DOCUMENT
    parsed = commands(text, None)
    assert len(parsed) == 3
    near(parsed[0], VALUES)
    near(parsed[1], BACK_VALUES)
    for at in range(len(text)):
        assert len(commands(text[:at], text[at:], None)) == 3


def test_a_rot_of_several_digits_is_refused():
    """A line with a typing error must not drive a rover."""
    line = PidLine()
    assert line.feed(b"200,30,5,200,30,5,1.0,10\n") == []
    assert line.fault.startswith("rot is 10")
    assert line.feed(b"200,30,5,200,30,5,1.0,0,7\n") == []
    assert line.fault.startswith("more than 8 values")
    assert line.faults == 2
    assert line.feed(b"200,30,5,200,30,5,1.0,57,30,5,200,30,5,1.0,0\n") == []
    assert line.faults == 3


def test_an_invalid_line_does_not_affect_others():
    line = PidLine()
    parsed = line.feed(b"hello\n\xff\xfe,\x01\n" + DOCUMENT.encode() + b"\n1,2,3\n")
    near(parsed[0], VALUES)
    assert len(parsed) == 1 and line.faults == 3
    assert line.fault.startswith("3 values instead of 8")


def test_a_line_without_end_is_dropped():
    line = PidLine()
    for _ in range(20):
        assert line.feed(b"1" * 50) == []
        assert len(line._text) <= MAX_LINE
    assert line.faults == 1 and "without an end" in line.fault
    assert line.feed(b"\n" + DOCUMENT.encode() + b"\n")
    assert line.faults == 1


def test_an_incomplete_line_at_a_pause_is_a_fault():
    line = PidLine()
    line.feed(b"200,30,5,2")
    assert line.flush() == [] and line.fault.startswith("4 values instead of 8")
    assert len(line.feed(DOCUMENT.encode() + b"\n")) == 1
