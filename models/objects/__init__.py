"""The 36 rigid test objects: `catalogue.get_object` by number, their signed distance, and their surface as a mesh."""
