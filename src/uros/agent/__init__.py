"""The agent: the server that speaks for boards on the ROS 2 network.

=================  =============================================================================
``agent``          All clients of one agent: who may come in, and whose a datagram is
``context``        What the parts of the agent use of it and of each other: AgentContext and its
                   neighbours
``clock``          The agent's clock: the one place where the core of the agent takes the time
                   from
``log``            Log lines in the columns of the C++ agent
``malloc_trim``    Memory that clients have left goes back to the system
``server``         The agent's one thread: sockets, timers and middleware around an Agent
``watchdog``       Tells where the agent's one thread hangs, when it does
``objects``        A client's objects: how they are described, created, looked up and deleted
``observability``  What a person sees of an agent: messages, captures, snapshots, metrics
``persistence``    Sessions that survive a restart of the agent (``--state``)
``policy``         What clients may do: rules, admission, limits, budgets, and when they are
                   removed
``session``        One client's XRCE session: streams, submessages, acknowledgements, and
                   reading
``transports``     The agent's ends of all transports: what listens for boards, and the plumbing
                   below it
=================  =============================================================================
"""
