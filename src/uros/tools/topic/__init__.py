"""``uros topic``: a module for each verb.

===========  =====================================================================================
``bw``       ``uros topic bw``: print the bandwidth that topics use
``delay``    ``uros topic delay``: print how old messages are, by the stamp of their header
``echo``     ``uros topic echo``: print messages of a topic
``find``     ``uros topic find``: list topics of a type
``hz``       ``uros topic hz``: print the average publishing rate of topics
``info``     ``uros topic info``: print information about a topic
``list``     ``uros topic list``: list topics
``lost``     Tells how many messages a command has not received, or had no time for
``measure``  What ``topic hz``, ``bw`` and ``delay`` share: options, subscriptions and the report
``output``   Standard output that a slow reader does not block, so that messages are still
             received
``pub``      ``uros topic pub``: publish messages to a topic
``type``     ``uros topic type``: print the type of a topic
===========  =====================================================================================
"""
