"""``uros image``: a module for each verb.

==========  ======================================================================================
``save``    ``uros image save``: the pictures of a topic, as files
``source``  A topic with pictures, compressed or raw: found when it comes, heard as publishers
            offer it
``view``    ``uros image view``: the pictures of a topic, live in a browser
==========  ======================================================================================
"""
