"""What a grasp shows: snapshots of every step, and the finger's surface for pictures."""
