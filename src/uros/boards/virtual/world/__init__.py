"""The environments of virtual boards: what sensors measure, cameras see and rovers drive in.

============  ==================================================================================
``arena``     The room that a rover drives in: four walls, and coloured boxes on the floor
``outdoors``  A place outdoors, where the board is carried slowly around a circle
``renderer``  Draws what a camera in an arena sees; needs Pillow (extra ``board``)
``room``      The room that the virtual sensors measure
``rover``     SprTurtleBot's body: two driven wheels, a caster and a battery, in an arena
============  ==================================================================================
"""
