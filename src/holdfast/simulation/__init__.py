"""Simulation: closed chains through time, always on the constraint."""
