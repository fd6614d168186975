"""What a grasp shows: snapshots of every step, the finger's surface for pictures, and input decks of CalculiX."""
