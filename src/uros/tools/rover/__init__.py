"""``uros pid`` and ``uros calibrate``: tuning a rover.

=============  ===================================================================================
``calibrate``  ``uros calibrate``: finds a rover's wheel radii and track from squares that it
               drives
``pid``        ``uros pid``: what a rover's wheels do, live in a browser, while their gains are
               tuned
=============  ===================================================================================
"""
