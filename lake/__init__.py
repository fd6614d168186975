"""The data lake: append-only Parquet tables, their schemas, DuckDB views, import and export."""
