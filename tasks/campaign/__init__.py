"""A campaign's config, its state as derived from the lake, and requests of people."""
