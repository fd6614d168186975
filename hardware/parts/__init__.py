"""The parts of the station, a class each: gantry, force sensor, air, places and routes, and what a safe state is."""
