"""The screening tier: a plane section of the finger instead of the solid."""
