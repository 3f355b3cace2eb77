"""A client's objects: how they are described, created, looked up and deleted.

==================  ===========================================================================
``application``     Reads an XRCE application: an XML document that lists entities.
``client``          One client: its session, its objects, and what its submessages do.
``endpoints``       The middleware's endpoints for datawriters, datareaders and services.
``factory``         Creates nodes and endpoints for CREATE, and all entities of an application.
``kinds``           The kinds of objects, the kind of each one's parent, and ids as text.
``object_info``     Answers GET_INFO about a client's objects (XRCE 8.3.5.3 and 8.3.5.7).
``object_table``    The record of an object, its limits, and the lookup of references.
``representation``  Parses a CREATE of any format into one form.
``ros_graph``       ``ros_to_microros_graph``: the ROS graph for boards that read it.
``xml_profiles``    Reads XML representations and reference files.
==================  ===========================================================================
"""
