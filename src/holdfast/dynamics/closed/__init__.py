"""Algorithms for the forward dynamics of the closed chain: arms, object and grasps together.

All quantities are along world axes, and about the contact points or C.
"""
