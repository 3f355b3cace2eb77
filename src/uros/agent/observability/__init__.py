"""Shows what an agent does: messages, captures, snapshots, metrics, diagnostics.

====================  ==========================================================================
``audit``             ``--audit FILE``: who was refused, by which rule, and how often
``capture``           ``--capture FILE``: every message that passes the agent, both ways, in a
                      file
``diagnostic_array``  ``diagnostic_msgs/msg/DiagnosticArray`` in CDR
``diagnostics``       ``--diagnostics``: the state of boards on ``/diagnostics``, for ROS tools
``format``            Formats one XRCE message of either direction as a line of text
``health``            Tells how a board or the agent is, as a diagnostic status
``jsonl``             The text format of captures and of ``uros trace``: one JSON line a message
``message_hooks``     Hooks that are called for each message that passes the agent
``pcapng``            Captured messages as pcapng, for Wireshark and tshark
``prometheus``        ``--metrics``: the agent's counters for Prometheus and its health, over HTTP
``readiness``         Tells whether an agent can serve boards now, and what is wrong with it
``snapshot``          State of the agent as one JSON object: transports, clients, refused clients
``status_socket``     The status socket: a Unix socket that the owner's tools query
====================  ==========================================================================
"""
