"""The bank: which simulations stand around the measured grasps, and the surrogate that they make.

`bank`: which they are, and as arrays. `surrogate`: every grasp at any theta with any effects. `effect_surfaces` and
`sensor_effects`: how effects that were simulated, and effects that act on finished traces, change its forces.
"""
