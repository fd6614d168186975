"""Where simulation and measurement disagree, once theta has been calibrated again.

`locate` does it all and writes the sentences. `residuals`: what is left, by phase. `strata`: what tools and objects are
split by. `permutation_tests`: which factors it goes with; `tree`: in which strata; `jackknife`: intervals over tools
and objects. `cells`: single cells with most of the gap, or with unsure forces.
"""
