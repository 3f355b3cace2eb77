"""``uros run``, and the nodes that it starts.

===================  =============================================================================
``command``          ``uros run``: the nodes that come with uros, each a file that shows how one
                     is written
``listener``         The listener of ROS 2's demos: prints what is said on the topic ``chatter``
``talker``           The talker of ROS 2's demos: says hello on the topic ``chatter``, once a
                     second
``trigger_service``  A service that a board can call: ``srv_trigger_py``, a std_srvs/Trigger
===================  =============================================================================
"""
