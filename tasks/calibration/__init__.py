"""Calibration on the lake's data.

`calibrate.infer` infers theta from a source and keeps calibration, draws and simulator version. `means` is the source
of mean forces, of what `mean_data` reads; `tasks.gap.theta` that of traces. `verify` simulates held-out designs with
the new theta, `drift` compares it with earlier ones.
"""
