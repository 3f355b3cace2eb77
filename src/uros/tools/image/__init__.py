"""``uros image``: a module for each verb.

==========  ======================================================================================
``save``    ``uros image save``: save the images of a topic to files
``source``  Subscribes to a topic with images, compressed or raw, with the QoS of its publishers
``view``    ``uros image view``: show the images of a topic live in a browser
==========  ======================================================================================
"""
