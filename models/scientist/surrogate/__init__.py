"""Bi-fidelity Gaussian process: one model of simulated and measured grasping forces (Eq. 1-6 of the FAST paper)."""
