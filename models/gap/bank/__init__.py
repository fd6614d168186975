"""The bank: simulations around the measured grasps, with and without effects."""
