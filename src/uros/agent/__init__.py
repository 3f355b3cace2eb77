"""The agent: the server that speaks for boards on the ROS 2 network.

One client, from the network in:

====================  ==========================================================
``session``           its streams: datagrams in, submessages out of them
``splices``           a message that a client gave up, and the next one behind it
``handler``           what a session needs of its client
``client``            its objects, and the rules of creating them
``representation``    what a CREATE says, whichever of three formats it uses
``profiles``          XML representations and reference files
``application``       XML documents that list entities, made and deleted as one
``kinds``             kinds of objects, and how ids are written
``objects``           what is kept of its objects; where references are looked up
``making``            what a CREATE makes on the network
``info``              answers to GET_INFO about objects
``control``           what the agent's owner decides for clients
``owners_values``     values that the owner writes
``endpoint``          writers, readers, requesters and repliers at work
``delivery``          READ_DATA: how many samples, how fast
``graph``             the ROS graph, for boards that ask for it
====================  ==========================================================

All of them:

====================  ==========================================================
``agent``             who is who, who comes and goes
``admission``         who may come in, and who was refused
``shares``            who leaves where no places are left
``rivals``            two who say that they are the same client
``lines``             clients whose line is gone
``liveliness``        who is still there
``limits``            what one may have, and all together
``backlog``           what waits in a reader of the middleware, in octets
``budget``            the account of memory; ``pace``: that of time
``heap``              memory goes back to the system
``server``            the one thread: sockets, timers, middleware
``clock``             its time
``watchdog``          tells where it hangs
``log``               lines in the columns that readers of the C++ agent know
====================  ==========================================================

What outlives it (``--state``): ``keeper`` has it written, ``entry`` knows how much of a client is,
``kept`` what that adds up to, ``state`` is the file; ``restoring`` brings it back.

What a person sees of it: ``taps``, where messages are listened to; ``describe``, what one means;
``capture``, a file of them in the form of ``jsonlines`` or ``pcapng``; ``snapshot``, how the agent
and its clients are, asked for by ``inspection`` and ``metrics``.
"""
