"""Strategies of the scientist side by side: same worlds, same budget, paired seeds."""
