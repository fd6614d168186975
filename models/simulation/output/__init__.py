"""What a solution leaves: records, surfaces, CalculiX decks."""
