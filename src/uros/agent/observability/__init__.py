"""What a person sees of an agent: messages, captures, snapshots, metrics.

=================  =============================================================================
``capture``        ``--capture FILE``: every message that passes the agent, both ways, in a file
``format``         One XRCE message, of either direction, as a line that a person reads
``jsonl``          The text form of captures, and of what ``uros trace`` is told: one JSON line
                   a message
``message_hooks``  Where the messages of boards can be listened to as they pass the agent
``pcapng``         Captured messages as pcapng, for Wireshark and tshark
``prometheus``     ``--metrics``: what an agent counts, for Prometheus, over HTTP
``snapshot``       What an agent's owner may see of it: transports, clients, who was refused, as
                   one JSON object
``status_socket``  Looking into a running agent: a Unix socket that its owner's tools ask
=================  =============================================================================
"""
