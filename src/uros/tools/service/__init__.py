"""``uros service``: a module for each verb.

========  ========================================================================================
``call``  ``uros service call``: call a service
``find``  ``uros service find``: list services of a type
``list``  ``uros service list``: list services
``type``  ``uros service type``: print the type of a service
========  ========================================================================================
"""
