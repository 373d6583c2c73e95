"""Rollouts: many steps of many systems in machine code, traced from the functions of `simulation`."""
