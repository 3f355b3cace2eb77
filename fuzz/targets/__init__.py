"""What is fuzzed. Each module has

``one_input(data)``
    plays any bytes; whatever it raises is a finding.
``seeds()``
    (name, bytes) of valid inputs to begin with.
``mutate(data, random, mutate_bytes)``
    optional: another input like ``data``, made with its structure in mind. ``mutate_bytes`` is
    the engine's own mutator.

Nothing here needs the fuzzing engine: tests play the kept inputs in plain Python.
"""

TARGETS = (
    "datagrams", "serial", "tcp", "can", "xml", "toml", "state", "recording", "modems",
    "definitions", "board_session",
)  # fmt: skip
