"""Simulated grasps: what is missing, worker processes that solve it, rows that keep it."""
