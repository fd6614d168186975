"""The page of a gap search."""
