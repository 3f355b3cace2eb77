"""``uros param``: a module for each verb.

============  ====================================================================================
``delete``    ``uros param delete``: delete a parameter
``describe``  ``uros param describe``: print type, description and constraints of parameters
``dump``      ``uros param dump``: print the parameters of a node as a parameter file
``file``      Parameter files: YAML, with namespaces and wildcards
``get``       ``uros param get``: print the value of a parameter
``list``      ``uros param list``: list the parameters of one node or of all
``load``      ``uros param load``: set the parameters of a node from a file
``node``      The node whose parameters a command reads or sets, and its parameter services
``set``       ``uros param set``: set parameters
``values``    Values of parameters: from YAML, as messages, and as text
============  ====================================================================================
"""
