"""Equilibrium of a step and the steps of a grasp: Newton's method, step control, and sparse Cholesky factorisation."""
