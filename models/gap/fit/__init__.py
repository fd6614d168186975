"""Fit of theta and effects to measured traces."""
