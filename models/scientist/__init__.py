"""The Bayesian scientist: `propose.propose` chooses the designs to simulate or print next.

`surrogate` is the two-fidelity Gaussian process that learns from both, `acquisition` the candidates and the rules that
value them.
"""
