"""Values of messages as text: YAML, CSV, and options that describe them.

=================  ===============================================================================
``fill``           Messages made of YAML text, as ``ros2 topic pub`` and ``ros2 service call``
                   take it, and printed as they print them
``plain``          Messages as plain values, as CSV, and their fields: what ``topic echo`` prints
``qos_publish``    The ``--qos-…`` options of what publishes: a profile by name, and single
                   policies
``qos_subscribe``  The ``--qos-…`` options: a profile by name, single policies, the rest as
                   publishers have it
``typed_values``   The positional arguments TYPE and VALUES, of which either may be left out, and
                   ``--stdin``
``yaml_read``      YAML text as nested dicts, lists and scalars, read by PyYAML
``yaml_text``      Plain values as YAML text, byte for byte as ``ros2 topic echo`` prints them
=================  ===============================================================================
"""
