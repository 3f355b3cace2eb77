"""``uros topic``: a module for each verb.

========  ========================================================================================
``echo``  ``uros topic echo``
``hz``    ``uros topic hz``
``info``  ``uros topic info``
``list``  ``uros topic list``
``pub``   ``uros topic pub``
========  ========================================================================================
"""
