"""Two minutes of the soak that `make soak` runs for an hour, and its detection of faults."""

import json
import sys
from pathlib import Path

import pytest
from soak.soak import Soak

LEAKY = Path(__file__).with_name("leaky_agent.py")

# Growth of the agent's memory from the middle to the end of two minutes, in %. An agent without
# leaks still grows for some minutes, until the allocators and DDS reach their final sizes: 2 to 4 %
# in this time, by the first life of each kind, not by further ones. There are 370 lives in between,
# so a leak of 7 kB a life is detected. `make soak`, an hour with 3 %, detects smaller ones.
TOLERANCE = 8.0


@pytest.mark.slow
@pytest.mark.timeout(400)
def test_boards_that_come_and_go_leak_nothing(domain_id: int) -> None:
    result = Soak(120, 100, 1, domain_id, TOLERANCE, quiet=True).run()
    print(json.dumps(result))
    assert result["wrong"] == [], result
    # Every way to leave, and every kind of line.
    counts = result["counts"]
    for name in ("close", "vanish", "silent", "reset", "mid_fragment", "udp", "tcp", "pty"):
        assert counts[name] >= 10, counts
    assert result["agent_cores"] < 0.5


@pytest.mark.slow
@pytest.mark.timeout(200)
def test_an_agent_that_loses_memory_sessions_or_descriptors_fails(own_domain_id: int) -> None:
    """An agent that leaks 100 kB for each client that leaves, and some sessions and descriptors."""
    result = Soak(
        60, 60, 2, own_domain_id, TOLERANCE, [sys.executable, str(LEAKY)], quiet=True
    ).run()
    wrong = "; ".join(result["wrong"])
    assert "memory grew" in wrong, result
    assert "sessions are left" in wrong, result
    assert "descriptors are open" in wrong, result


def test_an_agent_that_does_not_start_is_reported(own_domain_id: int) -> None:
    command = [sys.executable, "-c", "print('cannot')"]
    with pytest.raises(SystemExit, match="does not start: .*cannot"):
        Soak(1, 5, 1, own_domain_id, TOLERANCE, command, quiet=True).run()
