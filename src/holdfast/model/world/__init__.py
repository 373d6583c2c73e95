"""Shapes of the world that the object may touch, and the points of the object with which it does."""
