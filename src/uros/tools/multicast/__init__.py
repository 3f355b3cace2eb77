"""``uros multicast``: a module for each verb.

===========  =====================================================================================
``group``    The group and the port, as options and as sockets
``receive``  ``uros multicast receive``: wait for one UDP multicast datagram
``send``     ``uros multicast send``: send one UDP multicast datagram
``test``     ``uros multicast test``: send and receive on each network interface of this machine
===========  =====================================================================================
"""
