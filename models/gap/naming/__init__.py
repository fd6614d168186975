"""From a fit to a name: rank effects, fit and score the best as candidates, decide.

`name` does it all. `rank_effects`: secants of all effects, and what tells them apart. `candidates`: fits and held-out
scores. `patterns`: what no effect of the catalogue says. `second_look`: what is left after an effect. `families`: which
effects the data cannot tell apart. `drifts`: what changes from grasp to grasp, by repeats alone. `decide`, with the
lines and probabilities of `thresholds`: the answer.
"""
