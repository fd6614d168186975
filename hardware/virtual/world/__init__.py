"""What a virtual bench hides: the world file, its laws, the physics and state of the grasp."""
