"""``uros service``: a module for each verb.

==========  ======================================================================================
``call``    ``uros service call``: call a service
``client``  Clients of services, for the verbs that call them
``echo``    ``uros service echo``: print the requests and responses of a service
``events``  Events of service introspection: their topics, and how they are printed
``find``    ``uros service find``: list services of a type
``info``    ``uros service info``: print information about a service
``list``    ``uros service list``: list services
``type``    ``uros service type``: print the type of a service
==========  ======================================================================================
"""
