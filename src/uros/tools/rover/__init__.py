"""``uros pid`` and ``uros calibrate``: tuning a rover.

=============  ===================================================================================
``calibrate``  ``uros calibrate``: calibrate a rover's wheel radii and track by driving squares
``pid``        ``uros pid``: tune the wheel controllers of a rover, with a live plot in a browser
=============  ===================================================================================
"""
