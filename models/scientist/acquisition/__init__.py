"""What a candidate design is worth: max-value entropy search (`mes`), and expected improvement of a baseline."""
