"""The finger: its parameters, geometry, printability, print tray."""
