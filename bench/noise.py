"""A board that loads the agent.

    python bench/noise.py PORT calm|flood|stop SECONDS

``flood`` sends 50,000 best-effort samples a second; ``stop`` as many reliable ones as
the agent accepts, for a reader that is stopped; ``calm`` none. The flood ends with a
line: the number of samples a second that it has sent.
"""

from __future__ import annotations

import sys
import time

from load import BURST, Board, paced_send, text


def main() -> None:
    port, kind, seconds = int(sys.argv[1]), sys.argv[2], float(sys.argv[3])
    if kind == "calm":
        time.sleep(seconds)
        return
    board = Board(port, 0x6666, reliable=kind == "stop")
    if kind == "flood":
        count = int(50_000 * seconds)
        datagram = board.sample(text(64))
        seconds_taken = paced_send(board.sock, datagram, 2, count, 50_000, BURST)
        print(count / seconds_taken)
    else:
        board.send_reliable(10_000_000, 0, text(1000))


if __name__ == "__main__":
    main()
