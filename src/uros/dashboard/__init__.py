"""Pages that a browser shows live, served on this machine, and what stands behind them.

``serve``     HTTP for a few pages and what they ask for again and again
``pictures``  image messages, checked, as files that a browser shows
``samples``   a rover's torques and speeds, found in what it sends
``tuning``    the conversation with a rover whose wheels are tuned
``pages/``    HTML, CSS and JavaScript, which load nothing from elsewhere

Nothing here knows DDS: the verbs of `uros.tools` bring the messages.
"""
