"""Around the simulator: many designs at once, and progress of many simulations."""
