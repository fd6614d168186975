"""Sampling of a posterior and what to make of it, whatever it is of.

`parallel_chains.sample` runs NUTS (`nuts`) from starts that `optimise` finds; `diagnostics` says what is wrong with the
draws of a `result`; `summary` makes Table 2 of them and is the quality gate of what may be built on them.
"""
