"""Where simulation and measurement disagree, once theta has been calibrated again.

`locate` does it all and writes the sentences. `residuals`: what is left, by phase. `strata`: what tools and objects are
split by. `permutation_tests`: which factors it goes with; `tree`: in which strata; `variance_components`: how much goes
with what; `theta_by_stratum`: constants that vary.
"""
