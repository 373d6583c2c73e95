"""Steps and rollouts in machine code."""
