"""A domain for each module, and a peer in it: the fixtures of the group interop."""

from interop.conftest import agent, domain, peer

__all__ = ["agent", "domain", "peer"]
