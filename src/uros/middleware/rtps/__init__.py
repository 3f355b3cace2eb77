"""DDSI-RTPS in Python: nodes in the ROS 2 network without a DDS library.

==================  ==============================================================================
``ids``             The numbers of the protocol.
``locators``        Transport addresses, and the ports of domains and participants.
``kinds``           The kinds of submessages.
``submessages``     Messages as octets and as submessages.
``parameters``      Parameter lists: discovery data and inline QoS.
``reassembly``      Samples that arrive in fragments.
``reader``          A reader's side: order, acknowledgements.
``changes``         Samples in a writer's history, and what is sent of them.
``reader_proxy``    What a writer knows of a matched reader.
``writer``          A writer's side: history, heartbeats, repetition.
``remote``          What is known of another participant, and where it may be sent to.
``outbox``          Datagrams from what endpoints send.
``schedule``        Which endpoint or participant is due first.
``local``           Our writers and readers, and whether others match them.
``spdp``            Announcements of our participant.
``builtin``         Our endpoints of builtin topics.
``sedp``            Announcements of endpoints.
``liveliness``      Participant messages: our writers are alive.
``participant``     Our participant: all of the above, without sockets or a clock.
``network``         What a domain uses of the network, as the environment says.
``ip_sockets``      The sockets of one domain for one version of IP.
``udp``             The sockets of one domain, and its interfaces as they come and go.
``endpoints``       The contract's writers and readers.
``discovery_info``  ``ros_discovery_info`` of a domain: our nodes, and those of others.
``domain``          One domain: participant, sockets, endpoints of this process.
``services``        Service clients and servers in the forms of rmw_fastrtps and rmw_cyclonedds.
``node``            One ROS node.
``graph``           The graph of a domain, with rate-limited changes.
``middleware``      Implements the contract of :mod:`uros.middleware.base`.
==================  ==============================================================================

Each module imports only modules listed above it.
"""

from __future__ import annotations

from ..base import Middleware


def create() -> Middleware:
    """Return an RTPS middleware configured by this process's environment.

    Raises:
        MiddlewareError: The environment is wrong, or this platform lacks what it needs.
    """
    from .middleware import RtpsMiddleware

    return RtpsMiddleware()
