"""What keeps people and machine safe: safe state, supervisor, watches."""
