"""The lines by which a person tunes the wheels of a rover over TCP. Runs on MicroPython.

To the rover go the gains of both wheels and what to drive with them::

    R_Kp,R_Ki,R_Kd,L_Kp,L_Ki,L_Kd,speed,rot          200,30,5,200,30,5,1.0,0

``speed`` is in m/s, negative is backward; ``rot`` is 1 for counter-clockwise, -1 for clockwise, 0
for straight on. From the rover come whole numbers: the torques of the right and the left wheel
and, where it has more to tell, their speeds and the speeds they should have, in mm/s::

    torque_R,torque_L[,speed_R,speed_L[,target_R,target_L]]          113,-87,301,296,300,300

A line end closes each of them, and may be missing: :class:`PidLine`.
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
    """The eight numbers of a line, in the order of `NAMES`; ``rot`` is -1, 0 or 1.

    Spaces are allowed. ValueError: what is wrong with it, in words for the person who typed it.
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
    # float() takes more than a number's digits: nan, infinity, 1_0, other scripts' numerals, and
    # on MicroPython a mere point.
    digits = text[1:] if text[:1] in ("+", "-") else text
    if digits not in ("", ".") and digits.count(".") < 2 and all(it in _DIGITS for it in digits):
        return float(text)
    shown = "".join([it if " " < it < "\x7f" else "?" for it in text[:12]])
    raise ValueError("%s is %s, which is no number" % (name, shown or "missing"))


def format_gains(values: "tuple[float, ...]") -> str:
    """The line of these eight numbers, without a line end."""
    return ",".join(["%g" % value for value in values])


def format_sample(values: "tuple[float, ...]") -> str:
    """What a rover sends: whole numbers, without a line end."""
    return ",".join(["%d" % round(value) for value in values])


class PidLine:
    """Finds lines of gains in what comes over TCP, however it was cut or joined.

    A message has ended where

    - a line end follows (LF, CR, or a semicolon),
    - the next one begins: ``rot`` is one digit, so what follows it and goes on with a comma is
      another message that was sent without a line end,
    - nothing more came for a while: the program of the document sends each line without its end,
      and then only a pause says that it is whole. Who reads the socket knows that, and calls
      `flush` when nothing came for some 50 ms.

    What cannot be understood is left out up to the next end, counted in ``faults`` and told by
    ``fault``, the last one in words; nothing of it is returned, since a rover moves by this.
    """

    def __init__(self) -> None:
        self.fault = ""
        self.faults = 0
        self._text = ""
        self._skips = False

    def feed(self, octets: "bytes | bytearray | memoryview") -> "list[tuple[float, ...]]":
        """The commands that are known to be whole, each as of `parse_gains`."""
        found: "list[tuple[float, ...]]" = []
        for octet in octets:
            if octet in (10, 13, 59, 0):
                self._end(found)
            elif self._skips or octet in (9, 32):
                continue
            elif octet == 44 and self._text.count(",") == 7:
                self._next(found)
            elif len(self._text) == MAX_LINE:
                self._wrong("more than %d characters without an end" % MAX_LINE)
                self._skips = True
            else:
                self._text += chr(octet) if 32 < octet < 127 else "?"
        return found

    def flush(self) -> "list[tuple[float, ...]]":
        """There was a pause: what came before it is all of a message."""
        found: "list[tuple[float, ...]]" = []
        self._end(found)
        return found

    def _next(self, found: "list[tuple[float, ...]]") -> None:
        """A ninth comma's place: two messages without a line end between them, or nonsense."""
        at = self._text.rindex(",") + 1
        if self._text[at : at + 1] in ("+", "-"):
            at += 1
        rest = self._text[at + 1 :]
        if self._text[at : at + 1] not in ("0", "1") or not rest:
            self._wrong("more than 8 values: %s" % ",".join(NAMES))
            self._skips = True
            return
        self._text = self._text[: at + 1]
        self._end(found)
        self._text = rest + ","

    def _end(self, found: "list[tuple[float, ...]]") -> None:
        text, self._text = self._text, ""
        self._skips = False
        if text:
            try:
                found.append(parse_gains(text))
            except ValueError as error:
                self._wrong(str(error))

    def _wrong(self, text: str) -> None:
        self._text = ""
        self.fault = text
        self.faults += 1
