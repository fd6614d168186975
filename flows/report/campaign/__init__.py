"""The report of a campaign: `content` fetches what `queries` ask; each other file is what a reader sees in one place."""
