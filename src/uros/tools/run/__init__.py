"""``uros run``, and the nodes that it starts.

===================  =============================================================================
``command``          ``uros run``: run an example node of uros
``listener``         The listener of ROS 2's demos: prints the messages of the topic ``chatter``
``talker``           The talker of ROS 2's demos: publishes to the topic ``chatter`` once a second
``trigger_service``  A service that a board can call: ``srv_trigger_py``, a std_srvs/Trigger
===================  =============================================================================
"""
