"""Meshes of a finger: `build.build_mesh` is the one interface to both meshers, extrusion and fTetWild."""
