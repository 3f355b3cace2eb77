"""What the middlewares share for services.

A sample of a service carries the identity of the request it belongs to. There are two forms:
rmw_cyclonedds puts a header before the body (``request_header``), rmw_fastrtps uses RTPS inline QoS
(PID_RELATED_SAMPLE_IDENTITY), which Cyclone cannot write. ``rtps`` writes both, ``ros2`` what its
RMW does.

==================  =========================================================================
``names``           The ROS name and type of a service, from the DDS names of its two topics.
``form``            Detects which form of request identity other endpoints use.
``request_header``  The form of rmw_cyclonedds: a header before the body.
==================  =========================================================================
"""
