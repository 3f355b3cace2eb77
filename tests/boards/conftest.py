"""A domain of the module's own, and a peer in it: as in the group interop."""

from interop.conftest import agent, domain, peer

__all__ = ["agent", "domain", "peer"]
