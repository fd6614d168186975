"""Calibration of the simulator: Young's modulus, friction and Poisson's ratio from measurements.

`means` calibrates on mean pull-off forces of designs (Kennedy and O'Hagan; Eq. 9 to 12 of the FAST paper), `inference`
samples and judges posteriors, whatever of, and `traces` is what calibrations on force traces begin with: the grid of
simulations, its response surfaces, and errors of features. The fit of traces itself is `models.gap.fit`.
"""
