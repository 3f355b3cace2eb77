"""The command ``uros``. The path of a module is its command: ``uros topic echo`` is `topic.echo`.

=============  ===================================================================================
``cli``        The command line: finds the verb, imports its module, runs it, reports errors
``common``     What the verbs that look at a network have in common: options, joining, what to say
``demo``       ``uros demo``: a virtual board, an agent and a ROS 2 listener, on this machine
               alone
``errors``     Errors that end a command with one line for the user instead of a traceback
``fleet``      ``uros fleet``: the virtual boards of a file, and one agent for them
``pages``      What the verbs with a page in a browser have in common
``waiting``    Finding the type of a topic that may not be there yet
``agent``      ``uros agent`` and its verbs
``board``      ``uros board``: a module for each verb
``capture``    ``uros trace`` and ``uros replay``: captured messages
``doctor``     ``uros doctor``: a module for each subject that it checks
``image``      ``uros image``: a module for each verb
``interface``  ``uros interface``: a module for each verb
``node``       ``uros node``: a module for each verb
``rover``      ``uros pid`` and ``uros calibrate``: tuning a rover
``run``        ``uros run``, and the nodes that it starts
``service``    ``uros service``: a module for each verb
``topic``      ``uros topic``: a module for each verb
``values``     Values of messages as text: YAML, CSV, and options that describe them
=============  ===================================================================================
"""
