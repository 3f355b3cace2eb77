"""Programs on a host, straight on a middleware: the ROS graph, and reading topics.

==============  ================================================================
``names``       ROS names and DDS names of topics, services and types
``graph``       what the graph holds, under ROS names: topics, endpoints, nodes
``matching``    a QoS profile that all publishers of a topic match
``network``     one program's place in a domain: its node, its graph, its loop
==============  ================================================================
"""
