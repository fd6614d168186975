"""Effects: named, versioned pieces of physics that can be added to the grasp simulator."""
