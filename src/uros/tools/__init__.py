"""The command ``uros``. The path of a module is its command: ``uros topic echo`` is `topic.echo`.

===============  ================================================================================
``cli``          The command line: finds the verb, imports its module, runs it, reports errors
``common``       Options, joining the domain and hints, for the verbs on a ROS 2 network
``demo``         ``uros demo``: run a virtual board, an agent and a ROS 2 subscriber, on this
                 machine only
``empty``        Says why a list of the network is empty
``ending``       The end of a command that runs other processes: by signals, and without being
                 interrupted
``errors``       Errors that end a command with one line for the user instead of a traceback
``fleet``        ``uros fleet``: run the virtual boards that a file lists, and one agent for them
``graph_types``  Types of topics, services and actions in the graph: what ``type``, ``find`` and
                 others share
``listing``      Listings and infos as JSON
``pages``        Options and opening of the page, for the verbs with a page in a browser
``parser``       The parser of every command, whose errors are one line with the choice meant
``progress``     The progress of a command that takes seconds, on standard error
``sim_time``     Simulation time: ``-s/--use-sim-time``, and the time that the topic ``/clock``
                 tells
``type_lookup``  Definitions of types that no folder has: asked of nodes that use them
``waiting``      Waits for a topic and finds its type; finds a node
``action``       ``uros action``: a module for each verb
``agent``        ``uros agent`` and its verbs
``bag``          ``uros bag``: a module for each verb
``board``        ``uros board``: a module for each verb
``capture``      ``uros trace`` and ``uros replay``: captured messages
``completion``   ``uros completion``: completion of command lines in shells
``doctor``       ``uros doctor``: a module for each subject that it checks
``image``        ``uros image``: a module for each verb
``interface``    ``uros interface``: a module for each verb
``lifecycle``    ``uros lifecycle``: a module for each verb
``multicast``    ``uros multicast``: a module for each verb
``node``         ``uros node``: a module for each verb
``param``        ``uros param``: a module for each verb
``plot``         ``uros plot``: plot numbers of topics in the terminal
``rover``        ``uros pid`` and ``uros calibrate``: tuning a rover
``run``          ``uros run``, and the nodes that it starts
``service``      ``uros service``: a module for each verb
``tf``           ``uros tf``: a module for each verb
``topic``        ``uros topic``: a module for each verb
``values``       Values of messages as text: YAML, CSV, and options that describe them
===============  ================================================================================
"""
