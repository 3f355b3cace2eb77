"""``uros tf``: a module for each verb.

==============  ==================================================================================
``echo``        ``uros tf echo``: print the transform between two frames
``frames``      The tree of coordinate frames: look-up through it, and its faults
``listener``    Listens to ``/tf`` and ``/tf_static`` of a domain
``transforms``  Transforms between frames: pure mathematics of rotations and translations
``tree``        ``uros tf tree``: print the tree of frames
==============  ==================================================================================
"""
