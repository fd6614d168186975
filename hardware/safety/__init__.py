"""What keeps people and machine safe: supervisor, watches, heartbeat."""
