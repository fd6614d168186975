"""Calibration on force traces per (tool, object) instead of one mean force per design."""
