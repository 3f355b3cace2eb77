"""The agent: the server that speaks for boards on the ROS 2 network.

====================  ==========================================================
``session``           one client's streams: datagrams in, submessages out of them
``client``            one client's objects, and the rules of creating them
``representation``    what a CREATE says, whichever of three formats it uses
``profiles``          XML representations and reference files
``endpoint``          writers, readers, requesters and repliers at work
``delivery``          READ_DATA: how many samples, how fast
``agent``             all clients: who may come in, who is who
``server``            the one thread: sockets, timers, middleware
``log``               lines in the columns that readers of the C++ agent know
====================  ==========================================================
"""
