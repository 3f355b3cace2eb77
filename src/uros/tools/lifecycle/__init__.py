"""``uros lifecycle``: a module for each verb.

============  ====================================================================================
``get``       ``uros lifecycle get``: print the states of nodes
``list``      ``uros lifecycle list``: list the transitions of a node
``node``      Nodes with a life cycle, and their services
``nodes``     ``uros lifecycle nodes``: list the nodes with a life cycle
``set``       ``uros lifecycle set``: trigger a transition of a node
============  ====================================================================================
"""
