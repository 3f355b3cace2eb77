"""Programs on a host, straight on a middleware: nodes, the ROS graph, and reading topics.

==============  ================================================================
``graph``       what the graph holds, under ROS names: topics, endpoints, nodes
``matching``    a QoS profile that all publishers of a topic match
``network``     one program's place in a domain: its node, its graph, its loop
``direct``      a middleware in place of a board's connection to an agent
``interrupt``   Ctrl-C while a node or a network spins
``node``        the Node of a host: ``uros.Node``
``lifecycle``   a Node with a life cycle
==============  ================================================================
"""
