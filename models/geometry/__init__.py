"""Bodies made of the nine design parameters: planar profile, finger, print tray, batch sheet."""
