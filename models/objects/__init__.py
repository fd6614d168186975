"""The 36 rigid test objects: what they are, their signed distance and their meshes."""
