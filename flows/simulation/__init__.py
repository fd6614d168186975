"""Flows around single simulations: how far a plan has come, and the CalculiX deck of a grasp."""
