"""``uros bag``: a module for each verb, and what they share.

=================  ===============================================================================
``convert``        ``uros bag convert``: write bags with other settings
``info``           ``uros bag info``: print information about a bag
``recover``        ``uros bag recover``: finish a bag whose recording was cut off
``reindex``        ``uros bag reindex``: write metadata.yaml of a bag from its files
``selection``      Which topics are meant: names, types and regular expressions
``arguments``      The arguments of the verbs that read one bag
=================  ===============================================================================
"""
