"""Pure science: design space, geometry, objects, mesh, FEM, effects, surrogate, acquisition.

Takes arrays and frozen records, returns the same. Touches no file, no network, no device.
"""
