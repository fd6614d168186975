"""Equilibrium: load steps, Newton, and the sparse Cholesky under it."""
