"""``uros agent`` and its verbs.

==================  ==============================================================================
``ament``           ``uros agent ament``: make the ROS package ``micro_ros_agent``, which starts
                    ``uros agent``
``child_process``   An agent in a child process, for virtual boards. It ends with its parent,
                    however that ends
``command``         ``uros agent``: serve boards on one transport or several, with the C++ agent's
                    options
``config``          The configuration file: its tables, its mistakes, ``uros agent check``
``port_in_use``     Names the process that has the port which an agent wants
``quantities``      Writes time spans and sizes as text
``refusals``        Says what an agent has refused, by which rule, and what to do about it
``reload``          SIGHUP: a running agent reads its rules and certificates again
``running_agents``  Finds the agents that run on this machine and queries them over their status
                    sockets
``status``          ``uros agent status``: print the state of a running agent and of its boards
``unseen``          Says why a board or a node is not seen, as far as the agents here tell
``options``         The options of ``uros agent``, a module for each subject
==================  ==============================================================================
"""
