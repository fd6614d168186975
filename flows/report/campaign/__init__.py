"""The report of a campaign: its sections and figures."""
