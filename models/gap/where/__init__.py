"""Where simulation and measurement disagree, once theta has been calibrated again."""
