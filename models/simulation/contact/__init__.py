"""Contact of a finger with a rigid obstacle: points on its faces, the penalty law, friction, and the compiled loops."""
