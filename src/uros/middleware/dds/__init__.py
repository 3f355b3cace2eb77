"""The DDS middleware, on Eclipse Cyclone DDS: real ROS 2 nodes on the other side.

==========================  =======================================================================
``cyclone``                 The C interface of Cyclone: entities as integers, samples as bytes.
``builtin``                 Reads what Cyclone discovers, from its builtin topics.
``config``                  Cyclone's configuration, from ROS 2's environment variables.
``schedule``                Jobs with deadlines: what the middleware does by time.
``dispatcher``              The waitset, its thread, and the readers whose samples it reports.
``participant``             DDS participants, each shared by many nodes, and their discovery info.
``context``                 What the modules below share: dispatcher, schedule, and readers by
                            topic.
``endpoints``               Writers, readers, service clients and servers of one node.
``service_peers``           Finds the matched endpoints of a service that use a compatible form.
``discovery_info_reader``   Reads ``ros_discovery_info`` of other participants, within limits.
``discovery``               The participants, nodes and endpoints of a domain.
``paced_discovery``         The same, with at most one change each second.
``late_writer_heartbeat``   Makes Fast DDS writers that Cyclone discovers late send a heartbeat.
``type_conflict_detector``  Feeds ``type_conflicts`` from the builtin topics.
``domain``                  One domain: its participants, and what watches it for all of them.
``node``                    One ROS node.
``middleware``              Implements the contract of :mod:`uros.middleware.base`.
==========================  =======================================================================

Each module imports only modules listed above it.
"""

from __future__ import annotations

from ..base import Middleware


def create() -> Middleware:
    """Return a DDS middleware configured by this process's environment."""
    from .middleware import DdsMiddleware

    return DdsMiddleware()
