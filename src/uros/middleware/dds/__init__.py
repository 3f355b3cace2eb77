"""The DDS middleware, on Eclipse Cyclone DDS: real ROS 2 nodes on the other side.

==========================  ======================================================
``cyclone``                 the C interface: entities as integers, samples as bytes
``builtin``                 what Cyclone discovers, read from its builtin topics
``config``                  Cyclone's configuration from ROS 2's environment variables
``schedule``                what is done by time
``dispatcher``              the waitset, its thread, and the readers that are told of samples
``participant``             DDS participants shared by many nodes, and their discovery info
``context``                 what all parts below share
``endpoints``               writers, readers, service clients and servers
``service_peers``           which matched endpoints of a service are compatible
``discovery_info_reader``   reads ``ros_discovery_info`` of others, within limits
``discovery``               the participants, nodes and endpoints of a domain
``paced_discovery``         the same, with at most one change a second
``late_writer_heartbeat``   probe readers for Fast DDS writers that Cyclone discovers late
``suppressed_nodes``        empty discovery info for rclpy's participant in this process
``type_conflict_detector``  feeds the table of types from the builtin topics
``domain``                  one domain: its participants, and what watches it for all
``node``                    a node
``middleware``              the contract
==========================  ======================================================

Each module imports only modules listed above it.
"""

from __future__ import annotations

from ..base import Middleware


def create() -> Middleware:
    """Return a DDS middleware configured by this process's environment."""
    from .middleware import DdsMiddleware

    return DdsMiddleware()
