"""``uros trace`` and ``uros replay``: captured messages.

==============  ================================================================================
``lines``       The boards' ends of lines to an agent, for playing several boards in one thread
``pcapng``      pcapng files, read: those of ``uros agent --capture``, and what Wireshark or
                tcpdump took
``recordings``  Captured conversations, read: ours in both forms, and recordings of other agents
``replay``      ``uros replay``: the boards of a capture once more, and whether an agent answers
                as then
``script``      A capture as a play: what its boards say, and what the agent answered
``trace``       ``uros trace``: what boards and agent say to each other, a line a message
==============  ================================================================================
"""
