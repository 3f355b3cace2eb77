"""The only code that opens sockets and serial lines.

``base`` is the contract of an agent's transport; ``udp``, ``tcp`` and
``serial`` (with the pseudo-terminal) are the agent's ends of each.
"""
