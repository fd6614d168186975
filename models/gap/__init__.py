"""Gap discovery: where simulation and measurement disagree, which effect is missing, and how much of it that closes."""
