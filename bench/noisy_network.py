"""Ten boards at 20 Hz on the rtps middleware, beside faults and floods of the network.

    python bench/noisy_network.py [--quick]

Agent, healthy reader and noise are processes on hosts of their own, in network namespaces. The
reader is one of uros; half of the boards and of its readers are reliable. A latency is that from
``publish`` of a board to the reader's callback. The noise has the policy SCHED_IDLE, as it is that
of other machines. The goals are printed beside the figures, without a check.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / "tests"), str(ROOT / "src")]

from support.networks import run_isolated  # noqa: E402

CASES = (
    ("alone", "none", ()),
    ("60 participants, 3,000 endpoints come and go", "crowd", ()),
    ("1 MB messages beside 1 kHz ones", "large", ()),
    ("an interface that comes and goes", "interface", ()),
    ("a slow reader on Wi-Fi", "slow", ()),
    ("a flood of samples", "flood", ("samples",)),
    ("a flood of requests for samples", "flood", ("requests",)),
    ("a flood of heartbeats", "flood", ("heartbeats",)),
    ("a flood of announced endpoints", "flood", ("announcements",)),
    ("a flood of announced participants", "flood", ("participants",)),
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="a fifth of the time, noisy")
    seconds = 10 if parser.parse_args().quick else 50
    print(f"  {'':<58}{'p50, ms':>10}{'p99, ms':>10}{'lost, %':>10}{'in order':>10}")
    print(f"  {'goal':<58}{'':>10}{'≤ 10':>10}{'≤ 1':>10}{'yes':>10}")
    for title, scenario, arguments in CASES:
        output = run_isolated(
            "support.rtps_noise", "run", scenario, seconds, *arguments, is_idle=True
        )
        figures = json.loads(output.splitlines()[-1])
        for name in ("best effort", "reliable"):
            row = figures[name]
            print(
                f"  {title:<46}{name:<12}"
                f"{row['p50']:>10.2f}{row['p99']:>10.2f}{row['lost']:>10.2f}"
                f"{'yes' if row['in order'] else 'no':>10}",
                flush=True,
            )
            title = ""
        print(f"    {figures['noise']}")


if __name__ == "__main__":
    main()
