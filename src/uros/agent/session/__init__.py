"""One client's XRCE session: streams, submessages, acknowledgements, and reading.

==============  ================================================================================
``delivery``    READ_DATA at work: samples from a source to the client, as many and as fast as
                asked
``handler``     Who hears of what is in a client's messages
``reassembly``  Which message the fragments of a reliable stream make, where a client gave one
                up half-way
``session``     One client's XRCE session at the agent: streams, submessages, acknowledgements
==============  ================================================================================
"""
