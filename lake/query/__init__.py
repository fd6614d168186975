"""DuckDB over the lake: views, read-only SQL, lineage."""
