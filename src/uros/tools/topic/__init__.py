"""``uros topic``: a module for each verb.

========  ========================================================================================
``echo``  ``uros topic echo``: print messages of a topic
``hz``    ``uros topic hz``: print the average publishing rate of topics
``info``  ``uros topic info``: print information about a topic
``list``  ``uros topic list``: list topics
``pub``   ``uros topic pub``: publish messages to a topic
========  ========================================================================================
"""
