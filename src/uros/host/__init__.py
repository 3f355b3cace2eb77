"""ROS 2 programs on a host, directly on a middleware: nodes, the ROS graph, topics.

=================  ===============================================================================
``graph_queries``  The ROS graph under ROS names: topics, endpoints, nodes.
``matching``       A QoS profile that all publishers of a topic match.
``network``        A program's participant in a domain: its node, its graph, its event loop.
``direct``         A middleware in place of a board's connection to an agent.
``background``     Turns of a connection while its program does something else.
``stop_signals``   Ctrl-C, SIGTERM and SIGHUP, as exceptions.
``interrupt``      These while a node or a network spins.
``no_agent``       A line for a program whose node no agent answers.
``node``           The Node of a host: ``uros.Node``.
``lifecycle``      A Node with a life cycle.
=================  ===============================================================================
"""
