"""Parameter values kept in a file across restarts."""

import json
import os

from .parameter import Parameter

try:
    from typing import Any, Callable
except ImportError:  # MicroPython
    pass

try:
    from binascii import crc32
except ImportError:  # a MicroPython without it

    def crc32(data: "Any", value: int = 0) -> int:  # type: ignore[misc]
        """Return 0: without a CRC the check sum is constant."""
        return 0


class ParameterFile:
    """Keeps the values that were set of a node's parameters in the file ``path``.

    ::

        ParameterServer(node, persist=ParameterFile("params.json"))

    A change is written at most ``period_sec`` later, together with all others until then; nothing
    is written without a change, because flash wears out. Call :meth:`save` before a planned
    power-off. The new file replaces the old one when it is complete. Unreadable parts of a file are
    reported, and the declared values apply.

    The file is JSON, ``{"name": [type, value], …}``, with a check sum in the last line. Delete that
    line when you edit the file by hand. ``writes`` and ``failures`` count writes.
    """

    def __init__(self, path: str, period_sec: float = 5.0) -> None:
        self.path = path
        self.values: "dict[str, Parameter]" = {}
        self.say: "Callable[[str], object]" = print
        self.writes = 0
        self.failures = 0
        self._period = period_sec
        self._written = ""
        self._timer: "Any" = None

    def open(self, node: "Any") -> None:
        """Read the file, and write changes while this node spins."""
        self._timer = node.create_timer(self._period, self.save)
        self._timer.cancel()
        fault = ""
        for path in (self.path, self.path + ".new"):
            try:
                with open(path) as file:
                    self._written = file.read()
                self._take(self._written)
                return
            except OSError:  # not written yet, or not renamed yet
                pass
            except Exception as error:  # flash may hold any bytes
                fault = fault or "%s is damaged (%s)" % (path, error)
            self._written = ""
        if fault:
            self.say("parameters: " + fault + "; the declared values count")

    def _take(self, text: str) -> None:
        body, _, last = text.strip().rpartition("\n")
        if body and len(last) == 8 and not last.strip("0123456789abcdef"):
            if last != "%08x" % crc32((body + "\n").encode()):
                raise ValueError("the check sum is wrong")
        else:
            body = text
        loaded = json.loads(body)
        if not isinstance(loaded, dict):
            raise ValueError("no object")
        for name in loaded:
            try:
                kind, value = loaded[name]
                if kind == 3:
                    value = float(value)  # a str for nan and inf; an int if edited by hand
                elif kind == 5:
                    value = bytes.fromhex(value)
                elif kind == 8:
                    value = [float(item) for item in value]
                self.values[name] = Parameter(name, kind, value)
            except Exception as error:
                self.refused(name, error)

    def refused(self, name: str, reason: "Any") -> None:
        """Drop a value of the file that cannot be used, and report it."""
        self.values.pop(name, None)
        self.say("parameters: %s of %s: %s; the declared value counts" % (name, self.path, reason))

    def changed(self, name: str, parameter: "Parameter | None") -> None:
        """Schedule a write: the parameter was set, or removed (None)."""
        if parameter is None:
            if self.values.pop(name, None) is None:
                return
        else:
            self.values[name] = parameter
        if self._timer.is_canceled():
            self._timer.reset()

    def save(self) -> bool:
        """Write unwritten changes now; return False if that failed."""
        text = self._text()
        if text != self._written:
            try:
                self._replace(text)
            except OSError as error:
                if not self.failures:
                    self.say("parameters: %s cannot be written: %s" % (self.path, error))
                self.failures += 1
                return False  # the timer continues and retries
            self._written = text
            self.writes += 1
        self._timer.cancel()
        return True

    def _text(self) -> str:
        parts = []
        for name in sorted(self.values):
            parameter = self.values[name]
            kind, value = parameter.kind, parameter.value
            if kind == 3:
                value = _plain(value)
            elif kind == 5:
                value = "".join(["%02x" % octet for octet in value])
            elif kind == 8:
                value = [_plain(item) for item in value]
            parts.append("%s: %s" % (json.dumps(name), json.dumps([kind, value])))
        body = "{" + ",\n".join(parts) + "}\n"
        return "%s%08x\n" % (body, crc32(body.encode()))

    def _replace(self, text: str) -> None:
        new = self.path + ".new"
        with open(new, "w") as file:
            file.write(text)
            file.flush()
            if hasattr(os, "fsync"):
                os.fsync(file.fileno())
        try:
            os.rename(new, self.path)
        except OSError:  # FAT cannot rename to an existing file
            os.remove(self.path)
            os.rename(new, self.path)


def _plain(value: float) -> "float | str":
    """Return a float, or a str for nan and inf, which JSON does not have."""
    return value if value - value == 0 else str(value)
