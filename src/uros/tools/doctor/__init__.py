"""``uros doctor``: a module for each subject that it checks.

=============  ===================================================================================
``agents``     Checks the agents on this machine: their ports, and their boards as the snapshots
               show them
``clock``      Checks clocks: the stamps of messages against this host's clock, and the clock
               itself
``command``    ``uros doctor``: find out why boards and ROS 2 nodes do not communicate on this
               machine
``finding``    The result of a check of ``uros doctor``
``graph``      Checks the ROS graph: names, domains and types of nodes and topics
``network``    Checks discovery: the environment, and multicast on the network interfaces
``process``    Finds the processes that use a device or a port, by Linux's /proc
``qos``        Checks the QoS of publishers and subscriptions: which pairs do not match, and how
               to fix them
``report``     ``uros doctor --report``: what this machine and its networks are, without a
               judgement
``serial``     Checks a serial device: existence, permission, other users, and the data that
               arrives
``snapshots``  Collects the snapshots of the agents that run on this machine
=============  ===================================================================================
"""
