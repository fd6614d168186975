"""Names, order and thresholds of the features of a trace; the formulas are in docs/explanation/trace-features.md."""

FEATURE_VERSION = 2  # raise it when a definition changes: the lake then calculates anew beside the old rows

STEP_MM = 0.5  # forces are averaged over steps of lift: 8 readings of the bench, 3 or 4 of a simulation
PROFILE_STEP_MM = 2.0
PROFILE_LIFT_MM = 60.0  # the tallest object is 50 mm: beyond, nothing is in the fingers
N_PROFILE = round(PROFILE_LIFT_MM / PROFILE_STEP_MM)
LONGEST_LIFT_MM = 120.0  # `GraspSetup.max_lift_mm`
MIN_LIFT_MM = 3.0  # a trace that lifts less shows no pull-off
END_MM = 2.0  # of lift, at its end: the bench lifts on for 4 mm after the object is free
DIP_MM = 3.0  # the object is still pushed down, if ever, at the start of the lift

HOLD = 0.8  # of the peak: above it the grasp holds
LET_GO = 0.2  # of the peak: below it the grasp has let go
SEPARATED = 0.1  # of the peak: below it the object is free
MIN_PROMINENCE = 0.08  # of the peak: a smaller rise between two valleys is no peak of its own
NOISE_N = 0.5  # more than five standard deviations of a step's mean on the virtual bench: less is no force
MIN_SLOPE_STEPS = 3

FEATURES = (
    "peak_force_n",
    "peak_lift_mm",
    "initial_force_n",
    "closing_lowest_n",
    "dip_n",
    "positive_after_mm",
    "work_j",
    "hold_start_mm",
    "hold_mm",
    "hold_force_n",
    "hold_slope_n_per_mm",
    "half_peak_lift_mm",
    "n_peaks",
    "prominence_n",
    "second_prominence_n",
    "drop_rate_n_per_mm",
    "lowest_after_n",
    "separation_lift_mm",
    "end_force_n",
)
