"""A virtual GRBL controller that answers as the firmware does."""
