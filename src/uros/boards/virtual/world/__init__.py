"""What sensors, cameras and rovers of virtual boards are in.

============  ==================================================================================
``arena``     The room that a rover drives in: four walls, and coloured boxes on the floor
``outdoors``  A place outdoors, where somebody carries the board slowly around a circle
``renderer``  Draws what a camera in an arena sees. Needs Pillow, which the extra ``board``
              brings
``room``      The room that the virtual sensors look at
``rover``     SprTurtleBot's body: two driven wheels, a caster, a battery, in a room with walls
============  ==================================================================================
"""
