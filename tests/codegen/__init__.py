"""Code for the robot: what leaves the library computes what the library computes."""
