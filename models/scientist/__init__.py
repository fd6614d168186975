"""The Bayesian scientist: what to print and what to simulate next (Eq. 1 to 8)."""
