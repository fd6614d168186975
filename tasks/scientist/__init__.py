"""What to print and simulate next: read the lake (`observe`), fit the surrogate (`fit`), propose (`propose`).

`simulation_only` is the baseline that never learns from a measurement.
"""
