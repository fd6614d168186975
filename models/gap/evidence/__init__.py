"""Evidence: one likelihood of all that is measured, for an alarm, for its name, and for what could still hide.

`reading`: measured grasps as means of cells and contrasts of repeats. `errors`: what honest simulators, prints,
placements and sensors differ by. `likelihood`: theta, moduli and variants fitted and integrated out. `candidates`: what
may be missing, each with its evidence and size. `rehearsal`: made-up worlds of the panel at hand, from which lines and
probabilities come. `decision`: the answer.
"""
