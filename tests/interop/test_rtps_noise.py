"""Ten boards at 20 Hz on an agent with rtps, beside a noisy network, in network namespaces.

What is asserted is what arrives at a healthy reader on another host, and its order. How long it
takes is the machine's: ``bench/noisy_network.py`` measures that.
"""

import json

import pytest
from support.networks import run_isolated
from support.variants import slow_except

pytestmark = pytest.mark.timeout(180)


def beside(scenario, seconds, *arguments, best_effort=1.0):
    """What the noise has done, beside boards that lose at most so many % of what is best effort."""
    output = run_isolated("support.rtps_noise", "run", scenario, seconds, *arguments)
    figures = json.loads(output.splitlines()[-1])
    for name, lost in (("best effort", best_effort), ("reliable", 0.0)):
        assert figures[name]["lost"] <= lost and figures[name]["in order"], figures
    return figures["noise"]


@pytest.mark.slow
def test_a_crowd_that_comes_and_goes():
    """60 participants with 3,000 endpoints, all of which agent and reader acknowledge."""
    assert beside("crowd", 5)["times"]


@pytest.mark.slow
def test_messages_of_a_megabyte_beside_a_thousand_small_ones_a_second():
    done = beside("large", 5)
    assert done["node"]["sizes"] == [1_000_008] and done["node"]["fast"]
    assert done["boards"]["read"]


@pytest.mark.slow
def test_an_interface_that_comes_and_goes_at_either_end():
    # Best effort is lost until the processes have had their turns; three times in these seconds.
    assert beside("interface", 9, best_effort=20.0)["times"] >= 2


@pytest.mark.slow
def test_a_slow_reader_behind_a_link_that_loses():
    """It gets some of what the boards send, of which 1 MB messages alone are too much for it."""
    done = beside("slow", 5)
    assert done["boards"]["large"] and any(done["reader"].values())


@pytest.mark.parametrize(
    "kind",
    slow_except(
        ["samples", "requests", "heartbeats", "announcements", "participants"],
        "samples",
    ),  # fmt: skip
)
def test_a_flood_of_one_participant(kind):
    """It sends as fast as the machine can: the ten boards send 800 samples meanwhile."""
    assert beside("flood", 4, kind)["sent"] > 2_000
