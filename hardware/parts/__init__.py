"""The parts of the cell, a class each: gantry, force sensor, air, places and routes, and what a safe state is."""
