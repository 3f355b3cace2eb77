"""``uros`` with faults: what a soak must find."""

import os
import sys

from uros.agent.agent import Agent
from uros.tools.cli import main

kept: list[object] = []
delete_client = Agent.delete_client


def leaky(self: Agent, key: int) -> bool:
    kept.append(bytearray(os.urandom(100_000)))
    if len(kept) % 50 == 0:
        kept.append(os.dup(0))
    return key % 16 == 0 or delete_client(self, key)


Agent.delete_client = leaky  # type: ignore[method-assign]
sys.exit(main())
