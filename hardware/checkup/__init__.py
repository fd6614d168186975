"""Looks at a bench without moving anything: ports, settings, sensors, watchdog; each failure ends with its fix."""
