"""Calibration: pairs of measured and simulated grasps from the lake, theta back into it.

`calibrate.calibrate_once` infers theta from `CalibrationData` and keeps calibration, draws and simulator version.
`means` is the kind of mean forces, of what `mean_data` reads, and verifies theta on held-out designs; `tasks.gap.theta`
is the kind of traces. `drift` compares theta with earlier ones.
"""
