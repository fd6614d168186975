"""Evidence: one likelihood of all that is measured, which ranks, alarms and names.

`reading`: measured grasps as means of cells and contrasts of repeats. `errors`: what honest simulators, prints,
placements and sensors differ by. `likelihood`: theta, moduli and variants fitted and integrated out. `laws` and
`drifts`: at which values effects are tried, how far their laws may differ, what may change from grasp to grasp.
`candidates`: what may be missing, each with its evidence and size. `trials`: the best in the simulator, and what they
leave. `worlds` and `rehearsal`: made-up worlds of the panel at hand, answered as the real one; `odds`: what is
learnt from them. `visible`: how large an effect must be to be seen.
"""

REHEARSED = 500  # made-up worlds of a panel, unless others are asked for
