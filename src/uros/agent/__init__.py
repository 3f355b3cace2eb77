"""The agent: the server through which boards take part in the ROS 2 network.

=================  ================================================================================
``agent``          All clients of one agent: admits them, and assigns each message to a client.
``clock``          The clock of the agent: the one place where its core reads the time.
``context``        Protocols of what the parts of the agent use of it and of each other.
``log``            Log lines in the columns of the C++ agent, and limits on how many.
``malloc_trim``    Returns freed memory to the system some time after clients have left.
``server``         Runs an agent: one thread with its sockets, timers and middleware.
``watchdog``       Logs which code the agent's one thread is in when it hangs.
``objects``        The objects of a client: how they are described, created, found and deleted.
``observability``  Shows what an agent does: messages, captures, snapshots, metrics.
``persistence``    Sessions that survive a restart of the agent (``--state``).
``policy``         What clients may do: rules, admission, limits, budgets, and when they are
                   removed.
``session``        The XRCE session of one client: streams, submessages, acknowledgements, reading.
``transports``     The agent's end of each transport, and what these ends share.
=================  ================================================================================
"""
