"""Sessions that survive a restart of the agent (``--state FILE``).

=================  =============================================================================
``journal``        The state file: slots of fixed size, followed by an append-only journal
``records``        The records of one client in the state file, and the client that they describe
``restore``        Restores the clients of the state file when an agent starts
``session_store``  The session store: writes sessions to the state file before they answer
``write_cursor``   How much of a client is already on disk, so that only changes are written
=================  =============================================================================
"""
