"""Work at the bench: print a batch, measure grasps, check the bench."""
