"""Volume meshes of the compliant body: extruded quadratic wedges, and quadratic tetrahedra of any body."""
