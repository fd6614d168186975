"""The elastic body: shape functions, the element's force and tangent, and their assembly over a mesh."""
