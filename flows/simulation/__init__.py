"""Around the simulator: progress of many simulations, and a grasp written as an input deck of CalculiX."""
