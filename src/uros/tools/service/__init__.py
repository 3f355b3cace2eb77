"""``uros service``: a module for each verb.

========  ========================================================================================
``call``  ``uros service call``
``find``  ``uros service find``
``list``  ``uros service list``
``type``  ``uros service type``
========  ========================================================================================
"""
