"""Measures pictures from a board: rate, load of the line, and the board's memory.

    .venv/bin/python bench/pictures.py [--quick]

A virtual board runs MicroPython 1.27 (WebAssembly) and publishes CompressedImages by
``publish_stream`` to an agent with DDS on loopback; a node on DDS takes them. Each picture is
compared. The lines are simulated with their baud rate, ten bits an octet; the board's UART has a
buffer of ``txbuf`` octets (2048) and does not block. A buffer of 512 is empty after 5.5 ms, so on a
busy machine the virtual board refills it too late. The high water, without MicroPython's own and
the virtual hardware, is that of a second run; over UDP it includes the copies of the virtual
board's ``socket``.

A line of 921,600 baud carries 92,160 octets a second: 4.6 pictures of 20,000 octets, without any
protocol. A USB serial port has no such limit.
"""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from process import DOMAIN, LOOPBACK  # noqa: E402

os.environ["CYCLONEDDS_URI"] = LOOPBACK

from support.pictures import picture, shoot  # noqa: E402

# The title, and the arguments of `shoot`.
CASES: tuple[tuple[str, dict[str, object]], ...] = (
    ("UDP, 5 Hz asked for", {"way": "udp", "period_ms": 200}),
    ("UDP, as fast as it goes", {"way": "udp"}),
    ("USB, as fast as it goes", {"way": "usb"}),
    ("UART, 921,600 baud", {"way": "uart", "txbuf": 2048}),
    ("UART, 921,600 baud, txbuf 512", {"way": "uart", "txbuf": 512}),
    ("UART, 921,600 baud, MTU 2048", {"way": "uart", "txbuf": 2048, "mtu": 2048}),
    (
        "UART, 921,600 baud, 5 Hz asked for",
        {"way": "uart", "txbuf": 2048, "period_ms": 200, "length": 17_000},
    ),
    (
        "921,600 bits of data a second, 5 Hz",  # without start and stop bits
        {"way": "uart", "txbuf": 2048, "period_ms": 200, "baud": 921_600 * 10 // 8},
    ),
    (
        "UART, 1,500,000 baud, 5 Hz asked for",
        {"way": "uart", "txbuf": 2048, "period_ms": 200, "baud": 1_500_000},
    ),
)


def main() -> int:
    count = 10 if "--quick" in sys.argv[1:] else 50
    print(f"{'':38}{'octets':>7}{'Hz':>8}{'line busy':>11}{'on it':>9}{'high water':>12}")
    failed = 0
    for name, options in CASES:
        options = {"length": 20_000, **options}
        length = int(str(options["length"]))
        with tempfile.TemporaryDirectory() as folder:
            shots = []
            for measure in (False, True):
                place = Path(folder, str(measure))
                place.mkdir()
                shots.append(
                    shoot(folder=place, domain=DOMAIN, count=count, measure=measure, **options)
                )
        for shot in shots:
            if shot.pictures != [picture(number, length) for number in range(count)]:
                print("not what was sent:", name)
                failed = 1
        shot, measured = shots
        line = f"{shot.busy:11.1%}{shot.octets / (count - 1):9.0f}" if shot.octets else " " * 20
        print(
            f"{name:38}{length:7}{shot.rate:8.2f}{line}{measured.heap.peak / 1000:9.1f} kB",
            flush=True,
        )
    return failed


if __name__ == "__main__":
    raise SystemExit(main())
