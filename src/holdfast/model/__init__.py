"""Joints, links, arms, the held object, grasps and the closed chain: frozen plain data."""
