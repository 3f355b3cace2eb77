"""``uros service``: a module for each verb.

==========  ======================================================================================
``call``    ``uros service call``: call a service
``client``  Clients of services, for the verbs that call them
``find``    ``uros service find``: list services of a type
``list``    ``uros service list``: list services
``type``    ``uros service type``: print the type of a service
==========  ======================================================================================
"""
