"""From arms, an object and grasps to a closed chain: where everything stands, and what is to be known about it."""
