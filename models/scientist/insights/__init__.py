"""What a campaign has taught: effects of parameters, whether to print again, the simplest finger that is as good."""
