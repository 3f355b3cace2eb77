"""The DDS middleware, on Eclipse Cyclone DDS: real ROS 2 nodes on the other side.

==================  ============================================================
``cyclone``         the C interface: entities as integers, samples as bytes
``builtin``         what Cyclone discovers, read from its builtin topics
``config``          what the ROS 2 environment variables ask of the network
``participant``     DDS participants shared by many nodes
``shared``          things made for their first user, unmade after their last
``announce``        ``ros_discovery_info``: which endpoint belongs to which node
``announced``       the same of others, within limits
``hidden``          that rclpy's participant in this process has no nodes of its own
``gids``            how long the Gids in it are
``endpoints``       writers, readers, and services in rmw_cyclonedds's format
``forms``           who else has that format, and keeping requests from all others
``watched``         a reader in the waitset, whatever it reads
``discovery``       reading the graph, for tools
``graph``           the same for boards, told at a pace
``offers``          Fast DDS writers whose first heartbeat was missed
``conflicts``       topics that somebody else has with another type
``middleware``      the contract, and the thread that waits for samples
==================  ============================================================
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .middleware import DdsMiddleware


def create() -> DdsMiddleware:
    """A DDS middleware configured by this process's environment."""
    from .middleware import DdsMiddleware

    return DdsMiddleware()
