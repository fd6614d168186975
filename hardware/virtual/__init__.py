"""Virtual devices: servers that speak the wire protocols of the real ones."""
