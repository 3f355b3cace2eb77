"""Text protocol by which a person tunes the wheels of a rover over TCP. Runs on MicroPython.

The rover receives the gains of both wheels and a command to drive with them::

    R_Kp,R_Ki,R_Kd,L_Kp,L_Ki,L_Kd,speed,rot          200,30,5,200,30,5,1.0,0

``speed`` is in m/s, negative is backward; ``rot`` is 1 for counter-clockwise, -1 for clockwise, 0
for straight on. The rover sends integers: the torques of the right and the left wheel and,
optionally, their speeds and target speeds in mm/s::

    torque_R,torque_L[,speed_R,speed_L[,target_R,target_L]]          113,-87,301,296,300,300

Each ends with a line end, which may be missing: :class:`PidLine`.
"""

try:
    from typing import Final
except ImportError:  # MicroPython
    pass

NAMES: "Final" = ("R_Kp", "R_Ki", "R_Kd", "L_Kp", "L_Ki", "L_Kd", "speed", "rot")
MAX_GAIN: "Final" = 10000
MAX_SPEED: "Final" = 5.0
# Attack: a line that never ends.
MAX_LINE: "Final" = 128

_DIGITS: "Final" = "0123456789."


def parse_gains(text: str) -> "tuple[float, ...]":
    """Return the eight numbers of a line, in the order of `NAMES`; ``rot`` is -1, 0 or 1.

    Spaces are allowed.

    Raises:
        ValueError: The line is invalid; the text is for the person who typed it.
    """
    fields = text.strip().split(",")
    if len(fields) != len(NAMES):
        raise ValueError(
            "%d value%s instead of 8: %s"
            % (len(fields), "" if len(fields) == 1 else "s", ",".join(NAMES))
        )
    values = []
    for name, field in zip(NAMES, fields):
        values.append(_number(name, field.strip()))
    for at in range(6):
        if not 0 <= values[at] <= MAX_GAIN:
            raise ValueError("%s is %g: a gain is 0 to %d" % (NAMES[at], values[at], MAX_GAIN))
    if not -MAX_SPEED <= values[6] <= MAX_SPEED:
        raise ValueError("speed is %g m/s: at most %g forward or backward" % (values[6], MAX_SPEED))
    if values[7] not in (-1, 0, 1):
        raise ValueError("rot is %g: 1 counter-clockwise, -1 clockwise, 0 none" % values[7])
    values[7] = int(values[7])
    return tuple(values)


def _number(name: str, text: str) -> float:
    # float() accepts more than decimal numbers: nan, infinity, 1_0, other scripts' numerals, and on
    # MicroPython a single point.
    digits = text[1:] if text[:1] in ("+", "-") else text
    if digits not in ("", ".") and digits.count(".") < 2 and not digits.strip(_DIGITS):
        return float(text)
    shown = "".join([char if " " < char < "\x7f" else "?" for char in text[:12]])
    raise ValueError("%s is %s, which is no number" % (name, shown or "missing"))


def format_gains(values: "tuple[float, ...]") -> str:
    """Return the line of these eight numbers, without a line end."""
    return ",".join(["%g" % value for value in values])


def format_sample(values: "tuple[float, ...]") -> str:
    """Return the line that a rover sends: rounded numbers, without a line end."""
    return ",".join(["%d" % round(value) for value in values])


class PidLine:
    """Parser of lines of gains in a TCP stream.

    A message ends where

    - a line end follows (LF, CR, or a semicolon),
    - the next one begins: ``rot`` is one digit, so more digits and a comma after it are another
      message, sent without a line end,
    - nothing more is received for a while: the protocol's reference program sends lines without
      an end, so that only a pause shows that one is complete. The reader of the socket calls
      `flush` when nothing was received for some 50 ms.

    Invalid input is dropped up to the next end and counted in ``faults``; ``fault`` is the text of
    the last one. Nothing of it is returned, since a rover moves by these numbers.
    """

    def __init__(self) -> None:
        self.fault = ""
        self.faults = 0
        self._text = ""
        self._skips = False

    def feed(self, octets: "bytes | bytearray | memoryview") -> "list[tuple[float, ...]]":
        """Process received bytes; return the complete commands, each as of `parse_gains`."""
        commands: "list[tuple[float, ...]]" = []
        for octet in octets:
            if octet in (10, 13, 59, 0):
                self._end(commands)
            elif self._skips or octet in (9, 32):
                continue
            elif octet == 44 and self._text.count(",") == 7:
                self._next(commands)
            elif len(self._text) == MAX_LINE:
                self._wrong("more than %d characters without an end" % MAX_LINE)
                self._skips = True
            else:
                self._text += chr(octet) if 32 < octet < 127 else "?"
        return commands

    def flush(self) -> "list[tuple[float, ...]]":
        """End the message after a pause; return its command, if it is valid."""
        commands: "list[tuple[float, ...]]" = []
        self._end(commands)
        return commands

    def _next(self, commands: "list[tuple[float, ...]]") -> None:
        """Handle an eighth comma: two messages without a line end between them, or a fault."""
        at = self._text.rindex(",") + 1
        if self._text[at : at + 1] in ("+", "-"):
            at += 1
        rest = self._text[at + 1 :]
        if self._text[at : at + 1] not in ("0", "1") or not rest:
            self._wrong("more than 8 values: %s" % ",".join(NAMES))
            self._skips = True
            return
        self._text = self._text[: at + 1]
        self._end(commands)
        self._text = rest + ","

    def _end(self, commands: "list[tuple[float, ...]]") -> None:
        text, self._text = self._text, ""
        self._skips = False
        if text:
            try:
                commands.append(parse_gains(text))
            except ValueError as error:
                self._wrong(str(error))

    def _wrong(self, text: str) -> None:
        self._text = ""
        self.fault = text
        self.faults += 1
