"""From a fit to a name: rank effects, fit and score the best as candidates, decide.

`name` does it all. `rank_effects`: secants of all effects, and what tells them apart. `candidates`: fits and held-out
scores. `upper_bound`: what anything could explain. `decide`, with the lines of `thresholds`: the decision.
"""
