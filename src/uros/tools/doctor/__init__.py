"""``uros doctor``: a module for each subject that it checks.

=============  ===================================================================================
``agents``     The agents on this machine: their ports, and what their snapshots tell of boards
``clock``      Clocks: the stamps of messages against this host's clock, and whether that one is
               right
``command``    ``uros doctor``: why boards and ROS 2 nodes do not meet on this machine, and what
               mends it
``finding``    What a check of ``uros doctor`` has found out
``graph``      What the graphs of the domains tell: ends of a topic that are apart, and types that
               differ
``network``    Discovery: what the environment allows, and whether multicast works on the
               interfaces
``process``    Who holds a device or a port on this machine, by Linux's /proc
``qos``        Which writers and readers of a topic do not reach each other for their QoS, and
               what mends it
``serial``     The serial device: whether it is there, may be opened, is free, and what comes over
               it
``snapshots``  The snapshots of the agents that run on this machine
=============  ===================================================================================
"""
