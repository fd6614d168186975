"""What a campaign has taught, from the rows of the lake: effects, advice to stop, health."""
