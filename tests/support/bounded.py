"""Runs a program whose nodes spin for a short time only: ``python -m support.bounded FILE``."""

import runpy
import sys

from uros.client import node as client
from uros.host import node as host

SECONDS = 1.0


def spin(self):
    """Spin for SECONDS, then end the program."""
    self.spin_some(SECONDS)
    raise SystemExit(0)


client.Node.spin = host.Node.spin = spin
runpy.run_path(sys.argv[1], run_name="__main__")
