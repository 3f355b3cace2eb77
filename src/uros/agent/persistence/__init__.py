"""Sessions that survive a restart of the agent (``--state``).

=================  =============================================================================
``journal``        The file of ``--state``: slots of fixed size in front, a journal behind
``records``        What the state file keeps of one client: its records, and what they add up to
``restore``        ``--state``: what the file has of clients is brought back when an agent
                   starts
``session_store``  ``--state``: sessions that outlive the agent
``write_cursor``   How much of a living client is in the state file, so that only what is new
                   gets there
=================  =============================================================================
"""
