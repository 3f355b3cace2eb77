"""The time that programs of firmware/ wait for a restarted agent."""

import ast

from support.paths import ROOT

FIRMWARE = ROOT / "firmware"


def test_every_program_waits_two_seconds_and_for_several_pings() -> None:
    """README.md states that sessions survive a restart of an agent with --state."""
    nodes = 0
    for path in FIRMWARE.glob("*/*.py"):
        for call in ast.walk(ast.parse(path.read_text())):
            if isinstance(call, ast.Call) and isinstance(call.func, ast.Name):
                given = {keyword.arg: ast.literal_eval(keyword.value) for keyword in call.keywords
                         if keyword.arg in ("ping_ms", "silence_ms")}  # fmt: skip
                nodes += call.func.id == "Node"
                silence_ms = given.get("silence_ms", 2000)
                assert silence_ms >= 2000, path
                assert silence_ms >= 2 * given.get("ping_ms", 200), path
    assert nodes >= 10
