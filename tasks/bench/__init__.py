"""Work at the bench: `print` a batch and confirm it, `plan` what a tool still owes, `measure` it.

`reference_grasps` adds grasps with a tool of their own, which show changes of the bench.
"""
