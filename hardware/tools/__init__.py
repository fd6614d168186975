"""Tools on the head and in the rack: change them, know where they are."""
