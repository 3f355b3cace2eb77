"""The ``ros_discovery_info`` topic: participants say on it which endpoint belongs to which node.

Every RMW on DDS uses it, so each middleware on RTPS here shares this package. What it costs to
read the topic from a network that anybody may write to is limited in ``intake``.

===============  =======================================================================
``codec``        Encodes the message, and decodes it within limits.
``gid_size``     Chooses 16 or 24 octets a Gid, by ROS_DISTRO or the other participants.
``intake``       Keeps others' messages, and limits the octets that are parsed each second.
``listed_node``  A base class of nodes that list their endpoints.
``node_entry``   A node of ours, and the endpoints that it lists.
===============  =======================================================================
"""
