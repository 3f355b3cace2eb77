"""``ros_discovery_info``: the topic on which participants say which endpoint belongs to which node.

Every RMW on DDS uses it, so each middleware on RTPS here shares this package. What it costs to
read the topic from a network that anybody may write to is limited in ``intake``.

============  ====================================================================
``codec``     the message: encode, and decode within limits
``gid_size``  16 or 24 octets a Gid: from ROS_DISTRO, or from the other participants
``intake``    what is kept of others' messages, and the octets parsed a second
============  ====================================================================
"""
