"""Calibration of theta, with effects or without, on the grasps of a surrogate; nothing here names an effect.

`recalibrate.recalibrate` fits, `posterior.sample_posterior` draws from the posterior around a fit. `fit`: what a fit
is. `whitened_features`: the space in which errors are alike, and the robust loss. `law_freedom`: what
a fit grants an effect beyond the catalogue's law, and the curve that comes of it.
`theta`: theta alone, as calibration quotes it.
"""
