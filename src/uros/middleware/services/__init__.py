"""What the middlewares share for services.

A sample of a service carries the identity of the request it belongs to. There are two forms:
rmw_cyclonedds puts a header before the body (``request_header``), rmw_fastrtps uses RTPS inline QoS
(PID_RELATED_SAMPLE_IDENTITY), which Cyclone cannot write; ``ros2`` carries that form by rclpy.

=====================  ===========================================================
``names``              ROS names and types of a service's two topics
``form``               which of the two forms an endpoint uses
``request_header``     the form of rmw_cyclonedds
``pending_endpoints``  clients and servers that wait for their type to be loaded
=====================  ===========================================================
"""
