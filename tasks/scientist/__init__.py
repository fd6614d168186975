"""What to print and simulate next: read the lake, fit the surrogate, propose."""
