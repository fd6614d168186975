"""Kennedy-O'Hagan calibration of the simulator (Eq. 9-12 of the FAST paper)."""
