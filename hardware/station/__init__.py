"""The grasp station: gantry, pneumatics and load cell working together on one grasp after the other."""
