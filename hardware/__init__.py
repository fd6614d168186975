"""Drivers, the grasp cell, interlocks; virtual devices that speak the real wire protocols."""
