"""Calibrate the simulator, on demand and on a schedule."""
