"""What clients may do: rules, admission, limits, budgets, and when they are removed.

==================  ============================================================================
``admission``       Which clients are admitted: keys, networks, number; and a record of refusals
``config_values``   Checks values of files and of the command line, with the texts of the errors
``eviction``        Which clients are deleted for new ones when no place is left: a share for
                    each address
``key_conflict``    Two clients with one key: a claimant at another address probes the incumbent
``limits``          The limits of one client, and of all clients together
``line_loss``       Deletes clients of lost lines, unless they come back soon
``liveliness``      Probes silent clients, and deletes those that stay silent
``memory_budget``   The account of the memory that all clients together make the agent hold
``reader_backlog``  Octets that wait in a middleware reader for its client: bounded and charged
``replacement``     Replaces rules and admission while boards are connected
``rules``           Rules of the agent's owner for clients: names, domain, QoS, limits
``time_budget``     Time budget: how much of the one thread's time goes into creating and deleting
``toml_file``       Reads a TOML file, and finds the lines of its keys
==================  ============================================================================
"""
