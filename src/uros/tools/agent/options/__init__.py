"""The options of ``uros agent``, a module for each subject.

=================  ===============================================================================
``admission``      The options of ``uros agent`` about who may come in, and how long one may be
                   silent
``capture``        The options of ``uros agent`` about captures
``limits``         The options of ``uros agent`` about how much boards may have
``rules``          The options of ``uros agent`` about what boards get on the network, which rules
                   can say too
``state``          The option of ``uros agent`` about restarts
``status_socket``  The options of ``uros agent`` about looking into it while it runs
``transports``     The transports of ``uros agent``: their options, and what is made of them
=================  ===============================================================================
"""
