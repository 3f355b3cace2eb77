"""Tests the codecs on MicroPython with every recorded datagram."""

import json

from mpy.harness import ROOT, MicroPython, portable_sources, shared_sources


def test_every_recorded_datagram(micropython: MicroPython) -> None:
    micropython.install(portable_sources())
    micropython.install(shared_sources())
    micropython.run("from support.conversation import check")
    count = 0
    for file in sorted((ROOT / "tests" / "captures").glob("*.jsonl")):
        if file.stem.startswith(("serial_", "tcp_")):
            continue  # framing has its own portable tests
        lines = [json.loads(line)["hex"] for line in file.read_text().splitlines()]
        micropython.run(f"for line in {lines!r}:\n    check(bytes.fromhex(line))")
        count += len(lines)
    assert count == 755
