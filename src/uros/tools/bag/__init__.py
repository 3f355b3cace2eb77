"""``uros bag``: a module for each verb, and what they share.

=====================  ============================================================================
``convert``            ``uros bag convert``: write bags with other settings
``info``               ``uros bag info``: print information about a bag
``recover``            ``uros bag recover``: finish a bag whose recording was cut off
``reindex``            ``uros bag reindex``: write metadata.yaml of a bag from its files
``arguments``          The arguments of the verbs that read one bag
``play``               ``uros bag play``: publish the messages of a bag
``record``             ``uros bag record``: record topics into a bag
``options``            Options that ``uros bag record`` and ``uros bag play`` share
``selection``          Which topics are meant: names, types and regular expressions
``qos_choice``         QoS profiles: overrides from a file, and what a player offers
``recorder``           The subscriptions of a recording
``definition_search``  Asks nodes for definitions that no folder has
``message_cache``      The messages between the network and the disk
``writer_thread``      The thread that writes a recording
``player``             Publishes messages when they are due
``play_clock``         The time of a bag while it is played
``read_ahead``         Reads messages of a bag in a thread, before they are due
``keyboard``           Single keys of the terminal
``status_line``        The lines of a command that runs for long, and its state
=====================  ============================================================================
"""
