"""``uros trace`` and ``uros replay``: captured messages.

===============  =================================================================================
``connections``  Connections of boards to an agent over UDP, TCP and serial lines, for several in
                 one thread
``pcapng``       Reads pcapng files: those of ``uros agent --capture``, and those of Wireshark or
                 tcpdump
``recordings``   Reads captures: those of ``uros agent`` in both forms, and recordings of other
                 agents
``records``      What every reader of captures gives: one record a message
``replay``       ``uros replay``: play a capture's boards to an agent and compare its answers
``script``       Makes a replay script of a capture: what its boards send, and what the agent
                 answered
``trace``        ``uros trace``: print the messages between boards and agent, one line each
===============  =================================================================================
"""
