"""The options of ``uros agent``, a module for each subject.

=================  ===============================================================================
``admission``      The options of ``uros agent`` about the admission of clients and their
                   liveliness
``audit``          The options of ``uros agent`` about the record of refusals
``capture``        The options of ``uros agent`` about captures
``group``          A titled group of options, which states each option once: its flags, its help,
                   its default
``limits``         The options of ``uros agent`` about how much boards may use
``rules``          The options of ``uros agent`` about what boards get on the network
``state``          The option of ``uros agent`` about restarts
``status_socket``  The options of ``uros agent`` about its status socket, its metrics and its
                   diagnostics
``transports``     The transports of ``uros agent``: declares their options and creates them
=================  ===============================================================================
"""
