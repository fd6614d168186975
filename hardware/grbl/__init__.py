"""GRBL 1.1 over serial: codec, link, driver and settings profile."""
