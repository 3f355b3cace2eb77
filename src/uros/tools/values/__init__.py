"""Values of messages as text: YAML, CSV, and options that describe them.

==================  ===============================================================================
``expression``      Evaluates the expression of ``--filter``, a small part of Python, on messages
``fill``            Fills messages with values in YAML, as ``ros2 topic pub`` does
``message_reader``  Reads messages, and warns about those that cannot be read
``plain``           Converts messages to plain values, CSV and ``repr`` text, as ros2 prints them
``qos_publish``     The ``--qos-…`` options of a publisher
``qos_subscribe``   The ``--qos-…`` options of a subscription, which adapts to the publishers
                    otherwise
``show_options``    The options of how messages are printed: ``--csv``, ``--no-arr`` and more
``typed_values``    The positional arguments TYPE and VALUES, either of which is optional, and
                    ``--stdin``
``yaml_read``       YAML text as nested dicts, lists and scalars, read by PyYAML
``yaml_text``       Plain values as YAML text, byte for byte as ``ros2 topic echo`` prints them
==================  ===============================================================================
"""
