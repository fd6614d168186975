"""The tables: their rows as records, schemas, links between them, and upgrades of older lakes."""
