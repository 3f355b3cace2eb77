"""``uros interface``: a module for each verb.

============  ====================================================================================
``build``     ``uros interface build``: build modules of interface types for a board
``list``      ``uros interface list``: list interface types
``package``   ``uros interface package``: list the interface types of a package
``packages``  ``uros interface packages``: list packages with interface types
``proto``     ``uros interface proto``: print a prototype of a message as YAML
``show``      ``uros interface show``: print the definition of an interface type
============  ====================================================================================
"""
