"""The tables: their rows as records, schemas, and links between them."""
