"""The grasp simulator: quasi-static, large-rotation finite elements with frictional contact.

Start at `grasp.simulate_grasp`: a design, an object and a simulator version (`version`) in, a force trace out.
`problem` collects what one finger's grasp is made of, `model` keeps what its grasps share, `finger` is one time step,
`actuation` the closing jaw. The folders: `mesh` (profile to elements), `body` (elastic forces), `contact` (penalty
contact with friction), `solver` (Newton, steps, Cholesky), `effects` (what a simulator version can switch on), `output`
(snapshots, surfaces).
"""
