"""Volume meshes of the compliant body: extruded quadratic hexahedra and wedges, and tetrahedra of any body."""
