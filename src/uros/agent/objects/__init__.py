"""A client's objects: how they are described, created, looked up and deleted.

==================  ============================================================================
``application``     An XRCE application: an XML document that lists entities, made and deleted
                    as one
``client``          One client: its session, its objects, and the rules of creating them
``endpoints``       What stands behind an XRCE object at the middleware
``factory``         What a CREATE makes on the network: nodes, endpoints, and all entities of an
                    application
``kinds``           Kinds of a client's objects, what each is made in, and how ids are written
``object_info``     The answer to GET_INFO about a client's objects (XRCE 8.3.5.3 and 8.3.5.7)
``object_table``    A client's objects: what is kept of them, their names, and where references
                    are looked up
``representation``  What a CREATE asks for, in one form whichever format described it
``ros_graph``       ``ros_to_microros_graph``: the ROS graph for boards that ask for it
``xml_profiles``    XML representations and reference files, as far as they say something a
                    board can mean
==================  ============================================================================
"""
