"""A board that its neighbours notice.

    python bench/noise.py PORT calm|flood|stop SECONDS

``flood`` sends 50,000 samples a second, best effort; ``stop`` as many reliable
ones as the agent takes, for a reader that stands still; ``calm`` none. The flood
ends with a line: how many a second it has sent.
"""

from __future__ import annotations

import sys
import time

from load import Board, paced_send, text


def main() -> None:
    port, what, seconds = int(sys.argv[1]), sys.argv[2], float(sys.argv[3])
    if what == "calm":
        time.sleep(seconds)
        return
    board = Board(port, 0x6666, reliable=what == "stop")
    if what == "flood":
        count = int(50_000 * seconds)
        took = paced_send(board.sock, board.sample(text(64), False), 2, count, 50_000)
        print(count / took)
    else:
        board.send_reliable(10_000_000, 0, text(1000))


if __name__ == "__main__":
    main()
