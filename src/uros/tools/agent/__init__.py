"""``uros agent`` and its verbs.

==================  ==============================================================================
``child_process``   An agent in a child process, for virtual boards. It ends with its parent,
                    however that ends
``command``         ``uros agent``: serve boards on one transport or several, with the C++ agent's
                    options
``running_agents``  Finds the agents that run on this machine and queries them over their status
                    sockets
``status``          ``uros agent status``: print the state of a running agent and of its boards
``options``         The options of ``uros agent``, a module for each subject
==================  ==============================================================================
"""
