"""Live pages for a browser, served on this machine, and the data for them.

``serve``     HTTP server of a few pages and their periodic requests
``pictures``  checks image messages and converts them to files for a browser
``samples``   parser of a rover's torques and speeds
``tuning``    the connection of a rover whose wheels are tuned
``pages/``    HTML, CSS and JavaScript, which load nothing from other hosts

The package does not use DDS: the verbs of `uros.tools` pass the messages to it.
"""
