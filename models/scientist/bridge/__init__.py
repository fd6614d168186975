"""The bridge to BoTorch: FAST's surrogate and acquisition rule as its parts, and a user's parts in their place."""
