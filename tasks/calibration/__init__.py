"""Calibration on the lake's data: read it, infer theta, keep the result."""
