"""A six-axis arm with a wrist force sensor as a bench: Universal Robots, by RTDE and URScript.

`settings` is the bench file, `link` the two connections, `bench` the grasps.
"""
