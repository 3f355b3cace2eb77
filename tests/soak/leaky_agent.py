"""``uros`` with leaks that a soak must detect."""

import os
import sys

from uros.agent.agent import Agent
from uros.tools.cli import main

leaked: list[object] = []
delete_client = Agent.delete_client


def leaky(self: Agent, key: int) -> bool:
    leaked.append(bytearray(os.urandom(100_000)))
    if len(leaked) % 50 == 0:
        leaked.append(os.dup(0))
    return key % 16 == 0 or delete_client(self, key)


Agent.delete_client = leaky  # type: ignore[method-assign]
sys.exit(main())
