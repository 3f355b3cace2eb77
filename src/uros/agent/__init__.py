"""The agent: the server that speaks for boards on the ROS 2 network.

====================  ==========================================================
``session``           one client's streams: datagrams in, submessages out of them
``client``            one client's objects, and the rules of creating them
``representation``    what a CREATE says, whichever of three formats it uses
``profiles``          XML representations and reference files
``application``       XML documents that list entities, made and deleted as one
``objects``           what is kept of a client's objects; where references are looked up
``info``              answers to GET_INFO about objects
``control``           what the agent's owner decides for clients
``endpoint``          writers, readers, requesters and repliers at work
``delivery``          READ_DATA: how many samples, how fast
``graph``             the ROS graph, for boards that ask for it
``agent``             all clients: who may come in, who is who
``server``            the one thread: sockets, timers, middleware
``log``               lines in the columns that readers of the C++ agent know
====================  ==========================================================
"""
