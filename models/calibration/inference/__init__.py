"""Sampling of a posterior: NUTS chains in processes, diagnostics, importance weights."""
