"""Slopes of a grasp: the derivative of its whole trace by parameters, from copies that walk along with it."""
