"""Contact with the object: points, law, friction."""
