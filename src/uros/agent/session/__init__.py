"""One client's XRCE session: streams, submessages, acknowledgements, and reading.

==============  =======================================================================
``delivery``    One READ_DATA: sends samples to the client at the rate it asked for.
``handler``     The protocol of what a session calls for the content of messages.
``reassembly``  Finds the message in fragments after a client gave up another half-way.
``session``     One client's XRCE session: streams, submessages and acknowledgements.
==============  =======================================================================
"""
