"""Evidence: one likelihood of all that is measured, which says whether anything is missing, and what could still hide.

`reading`: measured grasps as means of cells and contrasts of repeats. `errors`: what honest simulators, prints,
placements and sensors differ by. `likelihood`: theta, moduli and variants fitted and integrated out. `candidates`: what
may be missing, each with its evidence and size. `rehearsal`: made-up worlds of the panel at hand, from which the lines
come. `doubt`: whether "nothing is missing" may be said.
"""
