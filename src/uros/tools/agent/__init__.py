"""``uros agent`` and its verbs.

==================  ==============================================================================
``child_process``   An agent as a child process, for virtual boards. It ends with its parent,
                    however that ends
``command``         ``uros agent``: serve boards on one transport or several, with the C++ agent's
                    options
``running_agents``  Asking the agents that run on this machine: who they are, what they say
``status``          ``uros agent status``: how a running agent is, and the boards that it serves
``options``         The options of ``uros agent``, a module for each subject
==================  ==============================================================================
"""
