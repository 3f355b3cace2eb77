"""The fuzz targets. Each module has

``one_input(data)``
    plays any bytes; every exception is a finding.
``seeds()``
    (name, bytes) of valid inputs, to start with.
``mutate(data, random, mutate_bytes)``
    optional: a mutation of ``data`` that follows its structure. ``mutate_bytes`` is the engine's
    own mutator.

No target needs the fuzzing engine: tests play the kept inputs in plain Python.
"""

TARGETS = (
    "datagrams", "serial", "tcp", "can", "xml", "toml", "state", "recording", "modems",
    "definitions", "board_session", "rtps", "bags",
)  # fmt: skip
