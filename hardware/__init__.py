"""Drivers, the grasp station, interlocks; virtual devices that speak the real wire protocols."""
