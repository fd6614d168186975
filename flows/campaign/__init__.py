"""The campaign: start or continue it, run its bench and simulation loops, ask people, say how far it is."""
