"""What clients may do: rules, admission, limits, budgets, and when they are removed.

==================  ============================================================================
``admission``       Who may come in: keys, networks, how many; and a record of those who were
                    refused
``config_values``   Values that the agent's owner writes, in files and on the command line: what
                    they may be, and what is said else
``eviction``        Whose turn it is to leave where there are no places left: a share for each
                    address
``key_conflict``    Two who say they are the same client: one came with its key from elsewhere
``limits``          What one client, and all clients together, may have of an agent
``line_loss``       Clients whose line is gone leave, unless they come back soon
``liveliness``      Who is still there: silent clients are asked, and forgotten when they stay
                    silent
``memory_budget``   The account of the memory that clients make the agent hold, all of them
                    together
``reader_backlog``  What waits in a reader of the middleware for its client: octets, bounded and
                    charged
``rules``           What the agent's owner decides for clients: names, domain, QoS, limits
``time_budget``     Time budget: how much of the one thread's time goes into creating and deleting
==================  ============================================================================
"""
