"""Sampling of a posterior and what to make of it, whatever it is of.

`parallel_chains.sample` runs NUTS (`nuts`) from starts that `optimise` finds; `parameter` sums up the draws of one
parameter; a `result` is all draws with all that is wrong with them; `summary` makes Table 2 of them and is the quality
gate of what may be built on them.
"""
