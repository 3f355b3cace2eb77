"""``uros interface``: a module for each verb.

============  ====================================================================================
``build``     ``uros interface build``
``list``      ``uros interface list``
``package``   ``uros interface package``
``packages``  ``uros interface packages``
``proto``     ``uros interface proto``
``show``      ``uros interface show``
============  ====================================================================================
"""
