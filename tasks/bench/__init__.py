"""Work at the bench: `print` a batch and confirm it, `plan` what a tool still owes, `measure` it."""
