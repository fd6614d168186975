"""Benchmarks: what one unit of work costs, how accurate it is, and how often it fails; by name in `registry`."""
