"""The report of a campaign: `content` fetches what `queries` ask; each other file is one place that a reader sees."""
