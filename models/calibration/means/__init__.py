"""Calibration on mean pull-off forces (Kennedy and O'Hagan; Eq. 9 to 12)."""
