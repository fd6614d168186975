"""Rerun recordings (`.rrd`) of what the lake holds: a grasp, a design, a campaign as it runs, a simulated grasp.

`stream` and `scene` are what all of them share; `bench_timeline` sends a campaign grasp by grasp.
"""
