"""The catalogue of known effects on a grasp, one file per layer of the simulator.

`base` holds the hooks that an effect may override, `spec` its entry: all that a search, its bank and its pages know of
it; `states` is what a law may run along. `geometry`, `material`, `contact`, `actuation` and `sensor` hold the effects.
`catalogue` finds and builds them by name; `scaling` says when an effect breaks the proportion of forces to Young's
modulus.
"""
