"""A Universal Robots controller without a robot: RTDE and URScript on loopback, in front of a virtual world.

`urscript` reads programs, `controller` moves the arm and the world, `server` speaks the protocols.
"""
