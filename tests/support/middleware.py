"""The middleware of agents and host nodes in tests that claim nothing of a particular one.

``tests/run.py --middleware NAME`` chooses it, by an environment variable, for a whole run.
"""

import os

import uros
from uros.host.direct import Direct
from uros.middleware import open_middleware

CHOICES = ("dds", "rtps")
MIDDLEWARE = os.environ.get("UROS_TEST_MIDDLEWARE") or "dds"
if MIDDLEWARE not in CHOICES:
    raise ValueError(f"UROS_TEST_MIDDLEWARE is {MIDDLEWARE!r}; there are: {', '.join(CHOICES)}")
# The same where rclpy is to use services of boards, which dds cannot serve.
WITH_SERVICES = "auto" if MIDDLEWARE == "dds" else MIDDLEWARE


def host_node(name, domain, **options):
    """A host node that has joined the domain."""
    if WITH_SERVICES == "auto":  # the one that a node opens by itself
        return uros.Node(name, domain_id=domain, **options)
    return uros.Node(name, Direct(open_middleware(WITH_SERVICES), domain), **options)
